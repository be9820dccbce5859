"""Pictures: that the right thing is where it should be, and that nothing global is touched."""

import subprocess
import sys

import numpy as np
import pytest

from isphcli.output import plots

H = 1.0e-6


def tube(n=16, dim=3):
    """A square tube along x with a solid frame two spacings thick: points, velocity, wall distance, in SI."""
    grid = np.stack(np.meshgrid(*[np.arange(n)] * dim, indexing="ij"), axis=-1).reshape(-1, dim)
    x = (grid + 0.5) * H
    distance = np.min(np.minimum(x[:, 1:] - 2 * H, (n - 2) * H - x[:, 1:]), axis=1)
    velocity = np.zeros_like(x)
    velocity[:, 0] = 1e-4 * np.maximum(distance, 0) / H
    return x, velocity, distance


def image(path):
    from matplotlib.image import imread

    return imread(path)


@pytest.mark.parametrize("dim", [2, 3])
def test_solid_and_channel_are_where_they_are(dim):
    x, velocity, distance = tube(dim=dim)
    fluid = distance > 0
    x, speed = x[fluid][:, :2], velocity[fluid][:, 0]
    offset = np.zeros(len(x))
    filled, images = plots._splat(x, offset, H, np.zeros(2), np.full(2, 16 * H), {"speed": speed})
    rows = np.array([0.5, 1.5, 4.0, 8.0, 14.5]) / 16 * filled.shape[0]
    middle = filled[rows.astype(int), :]
    assert (middle[[0, 1, 4]] < plots._FILLED).all() and (middle[[2, 3]] > plots._FILLED).all()
    assert np.ptp(middle[3]) < 0.1  # as full at the ends of the box as within
    assert images["speed"][filled.shape[0] // 2].min() > 0.9 * speed.max() or dim == 3


def test_solids_are_drawn_where_they_are():
    """A disk of 5.3 spacings: no pixel of it off by more than two thirds of a pixel, where particles draw scallops."""
    shape, box = (300, 240), (np.zeros(2), np.array([12.0, 15.0]))
    distance = lambda x: np.linalg.norm(x[:, :2] - [6.2, 7.9], axis=1) - 5.3  # noqa: E731
    filled = plots._fill_by_distance(shape, box, (3, (0, 1), 2, 0.7), distance, 1.0)
    x, y = np.meshgrid((np.arange(240) + 0.5) / 20, (np.arange(300) + 0.5) / 20)
    exact = np.hypot(x - 6.2, y - 7.9) - 5.3
    assert np.abs(exact[(filled > plots._FILLED) != (exact > 0)]).max(initial=0.0) < 1 / 30
    assert filled.shape == shape and filled.min() == 0.0 and filled.max() == 1.0


@pytest.mark.parametrize("dim", [2, 3])
def test_slice_is_drawn(tmp_path, dim):
    x, velocity, distance = tube(dim=dim)
    box = {"lower": [0.0] * dim, "upper": [16 * H] * dim}
    path = tmp_path / "slice.png"
    phase = x[:, 0] > 8 * H
    plots.plot_slice(path, x, velocity, plots.Frame(dim, H, "tube", **box), distance=distance, permeability=1.2e-13,
                     phase=phase)
    picture = image(path)
    grey = np.abs(picture[..., :3] - np.array([0xDC, 0xDA, 0xD5]) / 255).max(axis=-1) < 0.01
    assert 0.08 < grey.mean() < 0.3  # the frame is 1/4 of the axes
    assert list(tmp_path.iterdir()) == [path]


def test_plane_follows_the_flow():
    x = np.random.default_rng(0).random((4000, 3))
    lower, upper = np.zeros(3), np.ones(3)
    for axis in range(3):
        across, normal, position = plots._choose_plane(x, 3, axis, lower, upper, 0.05, None)
        assert {axis, across, normal} == {0, 1, 2} and abs(position - 0.5) < 0.01
    assert plots._choose_plane(x, 3, 0, lower, upper, 0.05, (1, 0.3)) == (2, 1, 0.3)


def test_slice_at_rest_and_refusals(tmp_path):
    x, velocity, distance = tube()
    plots.plot_slice(tmp_path / "a.png", x, 0 * velocity, plots.Frame(3, H), distance=distance)
    with pytest.raises(ValueError, match="no fluid particle"):
        plots.plot_slice(tmp_path / "b.png", x, velocity, plots.Frame(3, H), distance=-np.abs(distance))
    velocity[1000] = np.nan
    with pytest.raises(ValueError, match="not finite"):
        plots.plot_slice(tmp_path / "b.png", x, velocity, plots.Frame(3, H))
    with pytest.raises(ValueError, match="no fluid in the plane"):
        plots.plot_slice(tmp_path / "b.png", x, 0 * velocity, plots.Frame(3, H, plane=(2, 0.5 * H)), distance=distance)
    assert not (tmp_path / "b.png").exists()


def history(n=40):
    return [
        {"step": i, "time": 0.1 * i, "dt": 0.1, "limit": "cfl", "iterations_poisson": 12 + i % 3,
         "residual_poisson": 1e-6, "divergence": 10.0**-i, "mean_velocity_x": 1.0, "mean_velocity_y": None}
        for i in range(n)
    ]  # fmt: skip


@pytest.mark.slow
def test_histories(tmp_path):
    plots.plot_histories(tmp_path / "h.png", history(), "title")
    assert image(tmp_path / "h.png").shape[0] > 500
    plots.plot_numerics(tmp_path / "n.png", history(), "title")
    plots.plot_numerics(tmp_path / "n.png", [{"step": 1, "iterations_stokes": 40}])
    assert image(tmp_path / "n.png").shape[0] > 300
    for draw in (plots.plot_histories, plots.plot_numerics):  # each has columns of its own
        with pytest.raises(ValueError, match="no column"):
            draw(tmp_path / "h.png", [{"step": 1}])
    with pytest.raises(ValueError, match="no column"):
        plots.plot_histories(tmp_path / "h.png", [{"step": 1, "iterations_stokes": 40}])


@pytest.mark.parametrize(
    "size, factor, unit", [(3.8e-4, 1e6, "µm"), (0.014, 1e3, "mm"), (2.0, 1.0, "m"), (0.0, 1.0, "m")]
)
def test_prefix(size, factor, unit):
    assert plots.prefix("m", size) == (factor, unit)
    assert plots.prefix("", size) == (1.0, "")


def test_permeability_in_both_units():
    assert plots._permeability(9.869233e-13) == r"permeability 9.87$\times$10$^{-13}$ m²  (1 darcy)"
    assert "(12 mD)" in plots._permeability(0.012 * plots.DARCY)


@pytest.mark.slow
def test_pyplot_stays_out_and_matplotlib_comes_late():
    code = (
        "import sys, numpy as np, isphcli.output.plots as p; assert 'matplotlib' not in sys.modules; "
        "import os, tempfile; y = np.arange(3.0); f = os.path.join(tempfile.mkdtemp(), 'a.png'); "
        "p.plot_numerics(f, [{'step': k, 'dt': k} for k in y]); assert 'matplotlib.pyplot' not in sys.modules"
    )
    subprocess.run([sys.executable, "-c", code], check=True)


def test_seldom_measured_columns_are_drawn():
    from matplotlib.figure import Figure

    axes = Figure().subplots()
    x, y = np.arange(100.0), np.full(100, np.nan)
    y[::20] = 60.0
    plots._line(axes, x, y, "black", "angle")
    assert axes.lines[0].get_xdata().tolist() == [0, 20, 40, 60, 80] and np.isfinite(axes.lines[0].get_ydata()).all()


def test_periodic_faces_are_carried_on_from_the_other_side():
    """A particle by the upper face is seen behind the lower one, and nowhere else."""
    points, offset = np.array([[0.9, 0.5]]), np.zeros(1)
    box = np.zeros(2), np.ones(2)
    found, _, _ = plots._carried_on(points, offset, {}, *box, 0.2, (True, False))
    assert np.allclose(found, [[0.9, 0.5], [-0.1, 0.5]])
    found, _, _ = plots._carried_on(points, offset, {}, *box, 0.2, (False, False))
    assert np.allclose(found, [[0.9, 0.5], [1.1, 0.5]])


def test_titles_are_shown_as_typed():
    from matplotlib.figure import Figure

    axes = Figure().subplots()
    plots.draw_headline(axes, "128^3 of $a_b$", "")
    assert axes.get_title(loc="left") == "128^3 of $a_b$" and not axes._left_title.get_parse_math()
