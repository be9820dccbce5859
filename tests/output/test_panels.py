"""Panels beside the pictures of a flow: that what is drawn is what was found."""

import numpy as np
import pytest

from isphcli.output import panels
from isphcli.output.panels import Numerics


@pytest.fixture
def figures(monkeypatch):
    """The figures that are saved."""
    kept = []
    monkeypatch.setattr(panels, "save_figure", lambda figure, path: kept.append(figure))
    return kept


ROWS = [{"y": 1e-5 * k, "pressure": -2.0 * k, "superficial_velocity": 1e-3 * (1 + 0.01 * (-1) ** k)} for k in range(8)]


def test_profile(figures):
    panels.plot_flow_profile("p.png", ROWS, 0.01, "title")
    left, right = figures[0].axes
    assert left.lines[0].get_ydata().tolist() == [row["pressure"] for row in ROWS]
    assert np.allclose(right.lines[0].get_ydata(), [1.01, 0.99] * 4)  # mm/s
    assert np.allclose(left.lines[0].get_xdata(), 10.0 * np.arange(8)) and "µm" in left.get_xlabel()
    assert "1.0e-02" in right.get_legend().get_texts()[0].get_text()
    with pytest.raises(ValueError, match="no profile"):
        panels.plot_flow_profile("p.png", [], 0.0)


def test_pores_with_the_resolution_marked_and_speeds(figures):
    """Half of the volume in pores of 3, half in those of 7 spacings: half is less than four across."""
    share = np.zeros(8)
    share[[2, 6]] = 0.5
    velocity = np.array([[3.0, 4.0], [0.0, 1.0]]).repeat([1, 3], axis=0)
    panels.plot_distributions("d.png", velocity, 1.0, (np.arange(9.0) + 0.5, share), "title")
    left, right = figures[0].axes
    assert "50 %" in left.get_legend().get_texts()[0].get_text()
    marked = {text.get_text() for text in right.get_legend().get_texts()}
    assert marked == {"mean 2 m/s", "median 1 m/s"}
    panels.plot_distributions("d.png", velocity, 1.0, None)
    assert len(figures[1].axes) == 1


def test_numerics(figures):
    known = {2e-6: 1.2e-12, 1e-6: 1.0e-12}
    found = Numerics({"x": [(1, 0.1), (2, 1e-7)]}, 1e-6, {"x": known}, {"x": 0.9e-12}, {"x": 0.1e-12}, ROWS, 0.01)
    panels.plot_steady_numerics("n.png", found)
    solver, spacings, mass = figures[0].axes
    assert solver.lines[0].get_ydata().tolist() == [0.1, 1e-7] and solver.get_yscale() == "log"
    assert spacings.lines[0].get_ydata().tolist() == [1.0e-12, 1.2e-12]
    bars = spacings.containers[0].lines[2][0].get_segments()[0]
    assert np.allclose(bars, [[0.0, 0.8e-12], [0.0, 1.0e-12]])  # extrapolated: at the limit
    assert np.allclose(mass.lines[0].get_ydata(), [1.0, -1.0] * 4)  # per cent
    panels.plot_steady_numerics("n.png", Numerics({"x": []}, 1e-6, {"x": {1e-6: 1.0e-12}}))
    assert len(figures[1].axes) == 1


def test_the_result_at_the_finest_spacing_is_drawn_there(figures):
    found = Numerics({}, 1e-6, {"x": {2e-6: 1.2, 1e-6: 1.0}}, {"x": 1.0}, {"x": 0.1})
    panels.plot_steady_numerics("n.png", found)
    assert figures[0].axes[1].containers[0].lines[2][0].get_segments()[0][0][0] == pytest.approx(1.0)


def test_growing_parts(figures):
    rows = [{"edge": e, "porosity": p, "permeability": k} for e, p, k in ((1, 0.2, 1), (1, 0.4, 3), (2, 0.3, 2))]
    panels.plot_representative_volume("r.png", rows)
    left, right = figures[0].axes
    assert np.allclose(left.lines[1].get_ydata(), [0.3, 0.3]) and np.allclose(right.lines[1].get_ydata(), [2, 2])


def test_files_are_written(tmp_path):
    line = np.array([0.0, 1.0])
    panels.plot_fit(tmp_path / "f.png", (line, line), (line, line), ("x", "y", "law"), "a $title^2")
    assert (tmp_path / "f.png").read_bytes()[:4] == b"\x89PNG"
