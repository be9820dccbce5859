"""Films of snapshots."""

import numpy as np
import pytest
from PIL import Image

from isphcli import api
from isphcli.runs.film import FilmError, make_film

CASE = {
    "title": "a square of oil", "geometry": {"box": [1.0, 1.0], "periodic": ["x", "y"], "fluid": "water", "shapes": [
        {"box": {"lower": [0.1, 0.1], "upper": [0.4, 0.4]}, "is": "oil"}]},
    "particles": {"spacing": 0.1}, "fluids": {name: {"density": 1, "viscosity": 1} for name in ("oil", "water")},
    "drive": {"body_force": [40.0, 0.0]}, "time": {"end": 0.15}, "output": {"every": 0.05, "plots": False},
}
GREEN = np.array([0x7F, 0xBF, 0x9B])  # the first fluid, see plots.PHASES


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    path = tmp_path_factory.mktemp("film") / "out"
    api.run(CASE, out=path, quiet=True)
    return path


@pytest.mark.slow
def test_a_frame_a_snapshot_in_which_the_fluid_moves(folder, tmp_path):
    """The body force moves everything by a t^2 / 2 = 0.45 of the box."""
    seen = []
    assert make_film(folder, tmp_path / "film.gif", 5.0, seen=lambda k, n: seen.append((k, n))) == 4
    assert seen == [(k, 4) for k in (1, 2, 3, 4)]
    with Image.open(tmp_path / "film.gif") as film:
        assert film.n_frames == 4 and film.info["duration"] == 200 and film.info["loop"] == 0
        places = []
        for number in (0, 3):
            film.seek(number)
            pixels = np.asarray(film.convert("RGB")).astype(int)
            green = (np.abs(pixels - GREEN).max(axis=2) < 12) & (np.arange(pixels.shape[1]) < 0.8 * pixels.shape[1])
            places.append(np.nonzero(green)[1].mean() / pixels.shape[1])
    assert places[1] - places[0] > 0.25  # of the picture, whose box is four fifths of it


def test_what_no_film_can_be_made_of(folder, tmp_path):
    with pytest.raises(FilmError, match="films are not written"):
        make_film(folder, tmp_path / "film.avi")
    with pytest.raises(FilmError, match="no case"):
        make_film(tmp_path, tmp_path / "film.gif")
    with pytest.raises(FilmError, match="not deep enough"):
        make_film(folder, tmp_path / "film.gif", view="3d")
    assert list(tmp_path.iterdir()) == []


@pytest.mark.slow
def test_mp4(folder, tmp_path):
    pytest.importorskip("imageio_ffmpeg")
    assert make_film(folder, tmp_path / "film.mp4") == 4
    assert (tmp_path / "film.mp4").read_bytes()[4:8] == b"ftyp"
