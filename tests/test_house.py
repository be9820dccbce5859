"""The rooms of the package: which may know which, no circles, one reading of the drive, tests that stand where their
modules do, and what compiled loops may not do.

Imports are read from the source, those inside functions and those for annotations alone too.
"""

import ast
from functools import cache
from pathlib import Path

import pytest

from tests.source import files_of, functions, imports, is_kernel, lines, not_annotated, taken

PACKAGE = Path(__file__).parents[1] / "isphcli"
FILES = files_of(PACKAGE)
PHYSICS = ("domain", "geometry", "operators", "solvers", "flow", "two_phase")
WORDS = ("case", "scene", "output", "runs")  # what physics is not to know, but for the stopwatch


@cache
def tree_of(name):
    """The parsed source of a file, which nobody changes."""
    return ast.parse(FILES[name].read_text(encoding="utf-8"))


ARROWS = {name: imports(name, tree_of(name), FILES) for name in FILES}


@cache
def nodes_of(name):
    """All nodes of the parsed source of a file."""
    return list(ast.walk(tree_of(name)))


def room(name):
    return name.partition(".")[0]


def forbidden(one, other):
    """Why a file may not import another, or nothing."""
    here, there = room(one), room(other)
    if here in PHYSICS and there in WORDS and other != "output.clock":
        return "physics knows nothing of cases, scenes, files and runs"
    if here == "flow" and there == "two_phase":
        return "the flow of one fluid knows nothing of two"
    if there == "preflight" and here not in ("preflight", "validation", "cli", "api"):
        return "only validation and the two doors, cli.py and api.py, import what is asked before a run"
    return ""


def test_the_reader_of_imports_sees_them():
    assert "solvers.krylov" in ARROWS["flow.stokes"] and "operators.wall_scene" in ARROWS["flow.step"]
    assert forbidden("flow.step", "output.files") and not forbidden("flow.step", "output.clock")


def test_forbidden_arrows():
    assert {(name, other): forbidden(name, other) for name in FILES for other in ARROWS[name]
            if forbidden(name, other)} == {}


def test_no_circle_of_files():
    """Files are taken away once they import none of those that are left: in a circle some stay."""
    left = dict(ARROWS)
    while free := [name for name, known in left.items() if not known & left.keys()]:
        for name in free:
            del left[name]
    assert {name: known & left.keys() for name, known in left.items()} == {}


def called(node):
    """The last word of what a call calls."""
    return node.func.attr if isinstance(node.func, ast.Attribute) else getattr(node.func, "id", "")


def test_no_import_by_a_name_that_is_computed():
    """An arrow that no reader of imports can see."""
    for name in FILES:
        for node in nodes_of(name):
            if isinstance(node, ast.Call) and called(node) in ("import_module", "__import__"):
                assert isinstance(node.args[0], ast.Constant), f"{name}:{node.lineno}"


def private(name):
    """Words with an underscore that a file takes from others: imported by name, or asked of a module."""
    found, modules = [], set()
    for node in nodes_of(name):
        if isinstance(node, ast.ImportFrom) and node.level:
            found += [alias.name for alias in node.names if alias.name.startswith("_")]
            modules |= {alias.asname or alias.name for alias in node.names}
    found += [ast.unparse(node) for node in nodes_of(name) if isinstance(node, ast.Attribute)
              and node.attr.startswith("_") and not node.attr.startswith("__")
              and isinstance(node.value, ast.Name) and node.value.id in modules]
    return [word for word in found if word != "__version__"]


def test_what_begins_with_an_underscore_stays_in_its_file():
    assert {name: private(name) for name in FILES if private(name)} == {}


READ_DRIVE = ("case.forcing", "case.checks")  # what it means, and whether it may be


def test_what_drives_a_flow_is_read_in_one_place():
    """`case.drive` is touched by `case/forcing.py` alone; a method of that name is called, not read."""
    read = []
    for name in [name for name in FILES if name not in READ_DRIVE]:
        methods = {id(node.func) for node in nodes_of(name) if isinstance(node, ast.Call)}
        read += [(name, node.lineno) for node in nodes_of(name)
                 if isinstance(node, ast.Attribute) and node.attr == "drive" and id(node) not in methods]
    assert read == []


TESTS = Path(__file__).parent
WITHOUT_TESTS = {  # modules without a file of tests of their own, and what tests them
    "case.blocks": "declarations: test_reader.py, test_docs.py and test_checks.py beside it read them",
    "domain.migration": "tests/test_moving_ranks.py runs cases on several processes",
    "flow.state": "data without a function",
    "geometry.protocol": "a protocol: test_shape_geometry.py and test_voxel_geometry.py test its two classes",
    **{f"geometry.images.{name}": "test_formats.py and test_read.py read every format" for name in (
        "hdf", "image", "matlab", "metaimage", "npy", "npz", "nrrd", "palabos", "picture", "raw", "slices", "tiff",
        "vti", "vtk")},
    "geometry.lengths": "a table: tests/scene/test_spheres.py and test_formats.py read headers with units",
    "geometry.iso_crossings": "compiled part of iso_surface",
    "geometry.nearest_wall": "compiled part of shape_geometry: its test compares with brute force and labels",
    "geometry.voxel_crossings": "compiled part of voxel_geometry",
    "geometry.voxel_lookup": "compiled part of voxel_geometry",
    "operators.fourth_order": "tests/flow/test_viscous_solve.py tests what the step makes of it",
    "operators.neighbourhood_class": "numbers and their table; test_narrow_pores.py tests the classes",
    "operators.pair_sums": "compiled part of apply",
    "operators.protocol": "a protocol: test_lattice_weights.py compares its two classes",
    "references.result": "data without a function",
    "runs.ranks": "tests/test_ranks.py runs cases on several processes",
    "runs.results": "test_run.py and test_moving_case.py read what runs leave",
    "runs.steady": "test_run.py runs steady cases whole",
    "scene.choose_measures": "test_two_fluid_cases.py runs cases with every measure",
}
# tests of what several modules of a room do together
OF_SEVERAL = {"runs.test_failing_runs", "geometry.images.test_formats", "references.test_several"}


def with_rooms(paths, folder):
    names = (path.relative_to(folder).with_suffix("").parts for path in paths)
    return {".".join(parts) for parts in names if len(parts) > 1 and not parts[-1].startswith("__")}


def test_tests_stand_where_their_modules_do():
    """isphcli/<room>/<module>.py has tests/<room>/test_<module>.py, and the other way round."""
    modules = with_rooms(FILES.values(), PACKAGE)
    tests = with_rooms(TESTS.rglob("test_*.py"), TESTS) - OF_SEVERAL
    tested = {name.replace(".test_", ".") for name in tests}
    assert modules - tested == set(WITHOUT_TESTS), "modules without tests, or with tests in spite of the list"
    assert tested - modules == set(), "tests of modules that are not there"


def test_one_class_has_a_name():
    """Public ones: a word of the case language and one of the geometry are told apart."""
    found = {}
    for name in FILES:
        for node in tree_of(name).body:
            if isinstance(node, ast.ClassDef) and not node.name.startswith("_"):
                found.setdefault(node.name, []).append(name)
    assert {word: names for word, names in found.items() if len(names) > 1} == {}


@pytest.mark.parametrize("folder", [name for name in PHYSICS if name != "geometry"])
def test_one_constant_has_a_name(folder):
    """Of the rooms of the equations: two limits of one room are told apart by their words."""
    names = [name.id for file in FILES if room(file) == folder for node in tree_of(file).body
             if isinstance(node, ast.Assign) for target in node.targets for name in ast.walk(target)
             if isinstance(name, ast.Name) and name.id.isupper()]
    assert names and [name for name in names if names.count(name) > 1] == []


def test_one_file_has_a_name():
    """But `protocol.py`, the protocols of a room."""
    stems = [name.rpartition(".")[2] for name in FILES]
    assert {stem for stem in stems if stems.count(stem) > 1} <= {"__init__", "protocol"}


def calls_of(name, word):
    return [node for node in nodes_of(name) if isinstance(node, ast.Call) and called(node) == word]


def test_loops_over_rows_are_threads_of_serial_kernels():
    """numba's parallel loops take two to four times as long to compile (`domain/row_threads.py`); a kernel that holds
    the lock of the interpreter would make the threads wait for each other."""
    for name in FILES:
        kernels = {node.name: ast.unparse(node.decorator_list[0]) for node in kernels_of(name)}
        assert [kernel for kernel, options in kernels.items() if "parallel=True" in options] == [], name
        handed = {ast.unparse(call.args[0]) for call in calls_of(name, "over_rows")} & kernels.keys()
        assert [kernel for kernel in handed if "nogil=True" not in kernels[kernel]] == [], name


def kernels_of(name):
    """The compiled functions of a file."""
    return [node for node in functions(tree_of(name)) if is_kernel(node)]


@cache
def called_by_kernels():
    """((file, kernel), (file, kernel that it calls)) of all of them, and what each is compiled with."""
    options = {(name, node.name): ast.unparse(node.decorator_list[0]) for name in FILES for node in kernels_of(name)}
    pairs = []
    for name in FILES:
        tree = tree_of(name)
        imported = {alias.name for node in tree.body if isinstance(node, ast.ImportFrom) for alias in node.names}
        for node in kernels_of(name):
            words = {ast.unparse(call.func) for call in ast.walk(node) if isinstance(call, ast.Call)}
            pairs += [((name, node.name), (file, word)) for file, word in options
                      if word in words and (file == name or word in imported)]
    return pairs, options


def test_sums_in_any_order_are_part_of_the_kernel_that_calls_them():
    """Such a function has other last digits alone than as part of another kernel, where it is optimised once more. A
    process that compiles both calls the one, a process that loads the kernel from the cache the other."""
    pairs, options = called_by_kernels()
    assert (("operators.pair_weights", "_rows"), ("operators.moments", "stencil_moments")) in pairs
    free = {kernel for kernel, said in options.items() if "fastmath={" in said or "fastmath=REDUCE" in said}
    assert {called for _, called in pairs if called in free and "forceinline=True" not in options[called]} == set()


@pytest.mark.parametrize("word", ["fastmath", "error_model"])
def test_kernels_inherit_no_rounding_from_those_that_call_them(word):
    """A kernel that does not say how it rounds is compiled as the first one that calls it is: its digits would depend
    on what a machine has run before."""
    pairs, options = called_by_kernels()
    assert [pair for pair in pairs if word in options[pair[0]] and word not in options[pair[1]]
            and "inline='always'" not in options[pair[1]]] == []


def test_functions_have_annotations():
    """mypy asks for them but in files that hold kernels, whose types numba finds."""
    missing = [(name, node.lineno, node.name, *not_annotated(node)) for name in FILES
               for node in functions(tree_of(name)) if not is_kernel(node) and not_annotated(node)]
    assert missing == []


def test_few_functions_take_many_arguments():
    """Of eight and more: what belongs together is handed on together. What is left are commands, and lists that have
    no parts."""
    many = [f"{name}.{node.name}" for name in FILES for node in functions(tree_of(name)) if len(taken(node)) > 7]
    assert len(many) < 10, many


def numbers_without_a_word(source):
    """Names of constants with numbers in them that have no comment: beside them, or above the lines that they stand
    in."""
    lines, calls = source.splitlines(), ("Path(", "TypeVar(")
    for node in ast.parse(source).body:
        if not isinstance(node, ast.Assign) or ast.unparse(node.value).startswith(calls):
            continue
        names = [name.id for name in ast.walk(node.targets[0]) if isinstance(name, ast.Name)]
        held = [type(part.value) for part in ast.walk(node.value) if isinstance(part, ast.Constant)]
        if not all(name.isupper() for name in names) or not {int, float} & set(held):
            continue
        above = node.lineno - 2
        while lines[above].strip() and "#" not in lines[above]:
            above -= 1
        if "#" not in lines[node.lineno - 1] + lines[node.end_lineno - 1] + lines[above]:
            yield from names


def test_the_reader_of_constants_sees_them():
    source = "\nA = 1\nB = 2  # m\nC = 3\n\n# s\nD, E = 4, 5\nF = 6\n\nG = {\n1: 2,\n}\n\nH = 'x'\nI = Path('x')\n"
    assert list(numbers_without_a_word(source)) == ["A", "G"]


def test_constants_say_what_they_bound():
    assert [(name, word) for name in FILES
            for word in numbers_without_a_word(FILES[name].read_text(encoding="utf-8"))] == []


LONGEST = 60  # lines of a function, which has fewer; kernels are long where their sums have to stay in registers


def test_functions_are_short():
    """What is longer does several things, each of which has a name of its own."""
    long = [(f"{name}.{node.name}", lines(node)) for name in FILES for node in functions(tree_of(name))
            if not is_kernel(node) and lines(node) >= LONGEST]
    assert long == []


def says_nothing(body, within=""):
    """Names of public functions, classes and methods without a docstring. What `scene(...)` decorates gets one from the
    words of the decorator."""
    for node in body:
        if isinstance(node, (ast.FunctionDef, ast.ClassDef)) and not node.name.startswith("_"):
            stated = any(ast.unparse(decorator).startswith("scene(") for decorator in node.decorator_list)
            if not stated and not ast.get_docstring(node):
                yield within + node.name
            if isinstance(node, ast.ClassDef):
                yield from says_nothing(node.body, f"{within}{node.name}.")


def test_the_reader_of_docstrings_sees_them():
    source = ('class A:\n "d"\n def f(self): pass\n def _g(self): pass\n'
              '@njit\ndef k(): return 1\n@scene("x")\ndef s(): pass')
    assert list(says_nothing(ast.parse(source).body)) == ["A.f", "k"]


def test_what_is_public_says_what_it_is():
    assert [(name, word) for name in FILES for word in says_nothing(tree_of(name).body)] == []


def test_no_field_is_of_any_type_whatever():
    """`object` says nothing of a field, a SimpleNamespace nothing of a result."""
    assert [(name, node.lineno) for name in FILES for node in nodes_of(name)
            if (isinstance(node, ast.AnnAssign) and ast.unparse(node.annotation) == "object")
            or (isinstance(node, ast.Name) and node.id == "SimpleNamespace")] == []


def test_no_geometry_is_asked_what_it_has():
    """What some geometries do not have is None in the protocol. In a case, `geometry` is a block and no geometry."""
    assert [(name, node.lineno) for name in FILES if room(name) != "case" for node in nodes_of(name)
            if isinstance(node, ast.Call) and isinstance(node.func, ast.Name)
            and node.func.id in ("getattr", "hasattr")
            and ast.unparse(node.args[0]).rpartition(".")[2] == "geometry"] == []
