"""What each of several processes is said to hold, against what they had."""

import numpy as np
import pytest

from isphcli.case.load import load_case
from isphcli.preflight.check import check
from tests.paths import CASES
from tests.preflight.cases import IMAGE, SPHERE, read


def test_two_processes_of_a_box_full_of_fluid():
    """Taylor-Green 32^3 (docs/clusters.md): 16,384 particles, of which others see two supports' faces; 4,096 remote
    ones and 0.296 GB were measured."""
    case = load_case(CASES / "taylor_green_3d.yaml", ("particles.spacing=0.03125",))
    ranks = check(case, ranks=2).ranks
    assert ranks.fluid == 16384 and ranks.remote == pytest.approx(2 * 2.1 * 32**2)
    assert sum(ranks.memory.values()) == pytest.approx(0.296e9, rel=0.15)


def test_one_process_has_no_remote_particles_and_the_time_of_one():
    found = check(read(SPHERE), ranks=1)
    assert found.ranks.remote == 0.0 and found.ranks.seconds == found.seconds and found.can_run


@pytest.mark.slow
def test_processes_that_are_not_worth_it_and_those_that_are_too_many():
    found = check(read(SPHERE), ranks=4)
    assert found.can_run and any("not worth it; run it in one process" in text for text in found.warnings)
    fine = check(read(SPHERE, "particles.spacing=0.025"), ranks=64)
    assert any("not worth it; take 2 at most" in text for text in fine.warnings)


def test_more_processes_than_particles_hold_nothing():
    found = check(read(SPHERE), ranks=5000)
    assert not found.can_run and "5,000 processes" in found.errors[0]
    assert found.ranks is None and "ranks  " not in found.text()


def test_the_second_solve_of_throats_is_shared_as_the_first_one_is():
    one, two = (check(read(SPHERE, "refine=throats"), ranks=ranks).ranks for ranks in (1, 2))
    first, second = (ranks.memory["half the spacing in throats"] for ranks in (one, two))
    assert 0.5 * first < second == pytest.approx(0.5 * first * (1.0 + two.remote / two.fluid))


def test_a_process_has_as_many_neighbours_in_rock_as_one_that_is_alone():
    """Half of what lies round a particle is solid: one of one process is said to need no more than the run."""
    found = check(read(SPHERE, "particles.spacing=0.05"), ranks=1)
    assert found.ranks.memory["operators"] == pytest.approx(found.memory["operators"])


@pytest.mark.slow
def test_an_image_is_held_by_parts(tmp_path):
    """40 bytes a voxel of a brick and its margin, of walls of either kind."""
    image = np.zeros((20, 20, 200), np.uint8)
    image[:, :3] = 1
    np.save(tmp_path / "rock.npy", image)
    text = IMAGE.replace("rock.npy", str(tmp_path / "rock.npy"))
    smooth, stairs = (check(read(text, f"geometry.wall_distance={kind}"), ranks=4).ranks.memory["image"]
                      for kind in ("smooth", "stairs"))
    assert smooth == stairs and 0.25 * 40 * image.size < smooth < 0.5 * 46 * image.size
    assert "each of 4: " in check(read(text), ranks=4).text()
