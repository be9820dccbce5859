"""Stiff and extreme scenes, small: each keeps its invariant. `isph validate --stress` runs them larger."""

import pytest
from click.testing import CliRunner

from isphcli.cli import OUTSIDE, main
from isphcli.validation import stress


@pytest.mark.slow
@pytest.mark.parametrize("scene", stress.SCENES, ids=lambda scene: scene.measure.__name__)
def test_the_invariant_holds(scene):
    assert scene.measure(False) <= scene.bound


def test_the_page_tells_what_fails(monkeypatch):
    """A scene beyond its bound and one that ends are told, and the exit code is that of a missed reference."""

    def ends(large):
        raise ValueError("no more")

    quarter = lambda large: 0.25  # noqa: E731
    scenes = [stress.StressScene("a", "b", "c", 0.5, quarter), stress.StressScene("d", "e", "f", 0.1, quarter),
              stress.StressScene("g", "h", "i", 1, ends)]
    monkeypatch.setattr(stress, "SCENES", scenes[:1])
    assert CliRunner().invoke(main, ["validate", "--stress", "--quiet"]).exit_code == 0
    monkeypatch.setattr(stress, "SCENES", scenes)
    done = CliRunner().invoke(main, ["validate", "--stress", "--quiet"])
    assert done.exit_code == OUTSIDE
    assert "| a | b | c | 0.25 | 0.5 |  |" in done.stdout
    assert "| d | e | f | 0.25 | 0.1 | fails |" in done.stdout
    assert "| g | h | i | ValueError: no more | 1 | fails |" in done.stdout and "1 of 3 scenes" in done.stdout
