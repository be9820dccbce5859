"""Files of a run: what is written can be read back, is whole, and is finite."""

import json
import math
import sys

import numpy as np
import pytest

from isphcli.output.files import (
    FLUSH_EVERY,
    SUMMARY_KEYS,
    History,
    NotFiniteError,
    Series,
    read_history,
    read_pvd,
    read_vtu,
    replacing,
    write_summary,
    write_text,
)
from tests.paths import ROOT

rng = np.random.default_rng(1)


def fields(n, dim):
    return {
        "velocity": rng.normal(size=(n, dim)),
        "pressure": rng.normal(size=n),
        "phase": np.zeros(n, dtype=np.int8),
        "distance": rng.random(n),
    }


@pytest.mark.parametrize("dim", [2, 3])
def test_snapshot_reads_back_bit_for_bit(tmp_path, dim):
    x = rng.random((50, dim)) * 1e-4
    f = fields(50, dim)
    path = Series(tmp_path, "rock").write(12, 0.5, x, f)
    assert path == tmp_path / "snapshots" / "rock_000012.vtu"
    points, data = read_vtu(path)
    assert np.array_equal(points[:, :dim], x) and not points[:, dim:].any()
    assert data["velocity"].shape == (50, 3) and np.array_equal(data["velocity"][:, :dim], f["velocity"])
    assert np.array_equal(data["pressure"], f["pressure"]) and data["phase"].dtype == np.int32


def test_a_snapshot_without_particles_is_refused(tmp_path):
    with pytest.raises(ValueError, match="no particles"):
        Series(tmp_path).write(0, 0.0, np.zeros((0, 3)), fields(0, 3))


def test_vtk_opens_the_series(tmp_path):
    vtk = pytest.importorskip("vtkmodules.vtkIOXML")
    series = Series(tmp_path, "rock")
    x = rng.random((20, 3))
    for step in (0, 10):
        path = series.write(step, 0.1 * step, x, fields(20, 3))
    reader = vtk.vtkXMLUnstructuredGridReader()
    reader.SetFileName(str(path))
    reader.Update()
    grid = reader.GetOutput()
    assert grid.GetNumberOfPoints() == grid.GetNumberOfCells() == 20
    assert grid.GetPointData().GetArray("velocity").GetNumberOfComponents() == 3
    assert read_pvd(series.path) == [
        (0.0, "snapshots/rock_000000.vtu"),
        (1.0, "snapshots/rock_000010.vtu"),
    ]


def test_series_goes_on_after_a_restart(tmp_path):
    series, x = Series(tmp_path), np.zeros((1, 2))
    for step in range(4):
        series.write(step, float(step), x, {})
    again = Series(tmp_path, resume_time=1.0)
    assert [t for t, _ in read_pvd(again.path)] == [0.0, 1.0]
    again.write(2, 1.5, x, {})
    assert [t for t, _ in read_pvd(again.path)] == [0.0, 1.0, 1.5]


@pytest.mark.parametrize("bad", [np.nan, np.inf])
def test_no_snapshot_with_nan(tmp_path, bad):
    f = fields(10, 2)
    f["pressure"][3:5] = bad
    series = Series(tmp_path)
    with pytest.raises(NotFiniteError, match="pressure: 2 of 10"):
        series.write(0, 0.0, np.zeros((10, 2)), f)
    assert not list((tmp_path / "snapshots").iterdir()) and not series.path.exists()


def test_distance_without_walls_is_left_out(tmp_path):
    x = np.zeros((3, 2))
    path = Series(tmp_path).write(0, 0.0, x, {"distance": np.full(3, np.inf)})
    assert "distance" not in read_vtu(path)[1]
    with pytest.raises(NotFiniteError, match="distance: 1 of 3"):
        Series(tmp_path).write(1, 0.0, x, {"distance": np.array([1.0, 2.0, np.inf])})


def test_wrong_length_is_named(tmp_path):
    with pytest.raises(ValueError, match=r"pressure: shape \(4,\) does not fit 3"):
        Series(tmp_path).write(0, 0.0, np.zeros((3, 2)), {"pressure": np.zeros(4)})


def test_a_failed_write_leaves_the_old_file(tmp_path):
    path = tmp_path / "a.txt"
    write_text(path, "old")
    with pytest.raises(RuntimeError), replacing(path) as temporary:
        temporary.write_text("half")
        raise RuntimeError
    assert path.read_text() == "old" and list(tmp_path.iterdir()) == [path]


def test_history_reads_back(tmp_path):
    path = tmp_path / "history.csv"
    with History(path) as history:
        history.append({"step": 1, "time": 0.1, "limit": "cfl", "iterations_p": np.int64(3), "p": None})
        history.append({"step": 2, "time": np.float64(0.2), "limit": "end", "p": 1e-7})
    assert read_history(path) == [
        {"step": 1, "time": 0.1, "limit": "cfl", "iterations_p": 3, "p": None},
        {"step": 2, "time": 0.2, "limit": "end", "iterations_p": None, "p": 1e-7},
    ]
    with open(path, "a", encoding="utf-8") as file:
        file.write("3,0.2")  # a run that was killed as it wrote
    with History(path, resume_step=1) as history:
        history.append({"step": 2, "time": 0.19, "change": 0.5})
    assert [(row["step"], row["time"], row["change"]) for row in read_history(path)] == [
        (1, 0.1, None), (2, 0.19, 0.5)]


def test_history_can_be_read_while_it_grows(tmp_path):
    history = History(tmp_path / "h.csv")
    for step in range(20):
        history.append({"step": step})
    assert len(read_history(history.path)) >= 20 - FLUSH_EVERY
    history.close()


def test_history_refuses_nan_and_new_columns(tmp_path):
    history = History(tmp_path / "h.csv")
    history.append({"dt": 1.0})
    with pytest.raises(NotFiniteError, match="dt in row 2"):
        history.append({"dt": math.nan})
    with pytest.raises(KeyError, match="residual"):
        history.append({"dt": 1.0, "residual": 1.0})
    history.close()


def test_summary(tmp_path):
    path = tmp_path / "summary.json"
    write_summary(
        path,
        {"extra": None, "time": np.float64(1.5), "title": "µ", "particles": {"fluid": np.int64(3)},
         "permeability_tensor": np.eye(2), "terms": {"viscosity", "pressure"}, "ok": np.bool_(True)},
    )  # fmt: skip
    read = json.loads(path.read_text(encoding="utf-8"))
    assert list(read) == ["title", "particles", "terms", "time", "permeability_tensor", "extra", "ok"]
    assert read["permeability_tensor"] == [[1, 0], [0, 1]] and read["ok"] is True
    assert read["terms"] == ["pressure", "viscosity"]
    with pytest.raises(NotFiniteError, match=r"errors\.velocity\[1\]"):
        write_summary(path, {"errors": {"velocity": [1.0, math.nan]}})
    assert json.loads(path.read_text(encoding="utf-8")) == read


def test_every_key_of_the_summary_is_documented():
    page = (ROOT / "docs" / "output.md").read_text(encoding="utf-8")
    assert [key for key in SUMMARY_KEYS if f"`{key}`" not in page] == []


def test_output_and_progress_import_nothing_heavy():
    import subprocess

    code = (
        "import sys, isphcli.output.files, isphcli.output.progress; "
        "assert not {'meshio', 'rich', 'matplotlib', 'scipy', 'numba'} & set(sys.modules)"
    )
    subprocess.run([sys.executable, "-c", code], check=True)
