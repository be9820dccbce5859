"""The list of mutations of benchmarks/mutations.py fits the source; running them is the benchmark's work."""

import importlib.util
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[1]
spec = importlib.util.spec_from_file_location("mutations", ROOT / "benchmarks" / "mutations.py")
mutations = importlib.util.module_from_spec(spec)
spec.loader.exec_module(mutations)


@pytest.mark.parametrize("mutation", mutations.MUTATIONS, ids=lambda m: m.name)
def test_a_mutation_changes_what_compiles(mutation):
    source = mutations.file_of(ROOT / "isphcli", mutation.module).read_text()
    mutated = mutations.mutate(source, mutation)
    compile(mutated, mutation.module, "exec")
    assert mutated != source


@pytest.mark.parametrize("mutation", [m for m in mutations.MUTATIONS if m.test], ids=lambda m: m.name)
def test_the_test_that_notices_a_mutation_is_there(mutation):
    """What no reference misses and a test notices: benchmarks/mutations.py names the test."""
    path, _, name = mutation.test.partition("::")
    assert mutation.unnoticed and f"\ndef {name}(" in (ROOT / path).read_text()


@pytest.mark.slow
def test_a_changed_kernel_drops_the_kernels_that_hold_it():
    held = {"operators.kernel", "operators.moments", "operators.wall_weights", "flow.step", "flow.shifting"}
    assert held <= mutations.dependents("operators.kernel")
    assert "operators.kernel" not in mutations.dependents("operators.wall_weights")


def test_quick_references_have_cases():
    assert all((ROOT / "cases" / f"{name}.yaml").exists() for name in mutations.QUICK + mutations.TWO_FLUIDS)


def test_misses_are_told_from_passes():
    def result(error, why, passed):
        verdict = {"why": why, "passed": passed, "word": "pass" if passed else "FAIL"}
        return {"levels": [{"error": error}], "verdict": verdict}

    results = {
        "fine": result(1e-4, "|0.0001| <= 0.001 at spacing 1", True),
        "off": result(-0.02, "|-0.02| > 0.01 at spacing 1", False),
        "broken": result(None, "SolveError: no", False),
        "hung": None,
    }
    found = mutations.misses(results)
    assert [ratio for ratio, _ in found] == [float("inf"), float("inf"), 2.0]
    assert found[-1][1] == "off (-0.02, bound 0.01)"
