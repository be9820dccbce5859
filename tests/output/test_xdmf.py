"""HDF5 with XDMF: exact, and open to other programs."""

import numpy as np
import pytest

from isphcli import api
from isphcli.output.files import NotFiniteError
from isphcli.output.grid import Grid
from isphcli.output.snapshots import read_series, read_snapshot

h5py = pytest.importorskip("h5py")
from isphcli.output.xdmf import XdmfSeries, read_h5  # noqa: E402

RNG = np.random.default_rng(2)
X = RNG.random((30, 2))
FIELDS = {"velocity": RNG.random((30, 2)), "pressure": RNG.random(30), "phase": np.arange(30) % 2}


def test_round_trip_is_exact(tmp_path):
    series = XdmfSeries(tmp_path)
    path = series.write(12, 0.1, X, FIELDS)
    x, fields = read_snapshot(path)
    assert np.array_equal(x[:, :2], X) and not x[:, 2].any()
    assert np.array_equal(fields["velocity"][:, :2], FIELDS["velocity"])
    assert np.array_equal(fields["pressure"], FIELDS["pressure"])
    assert np.array_equal(fields["phase"], FIELDS["phase"]) and fields["phase"].dtype == np.int32
    assert read_series(tmp_path) == [(0.1, "snapshots/particles_000012.h5")]


def test_a_series_goes_on_without_what_came_later(tmp_path):
    series = XdmfSeries(tmp_path)
    for step in range(4):
        series.write(step, 0.1 * step, X, FIELDS)
    again = XdmfSeries(tmp_path, resume_time=0.15)
    assert [time for time, _ in read_series(tmp_path)] == [0.0, 0.1]
    again.write(9, 0.9, X[:7], {"pressure": FIELDS["pressure"][:7]})
    assert read_series(tmp_path)[-1] == (0.9, "snapshots/particles_000009.h5")
    with pytest.raises(NotFiniteError):
        again.write(10, 1.0, X, {"pressure": np.full(30, np.nan)})
    assert len(read_series(tmp_path)) == 3


def test_particles_open_in_pyvista(tmp_path):
    pyvista = pytest.importorskip("pyvista")
    series = XdmfSeries(tmp_path)
    series.write(0, 0.0, X, FIELDS)
    series.write(1, 0.5, X + 1.0, FIELDS)
    reader = pyvista.get_reader(tmp_path / "particles.xdmf")
    assert reader.time_values == [0.0, 0.5]
    reader.set_active_time_value(0.5)
    mesh = reader.read()
    assert np.allclose(mesh.points[:, :2], X + 1.0, rtol=1e-7) and mesh.n_cells == 30
    assert np.array_equal(mesh.point_data["pressure"], FIELDS["pressure"])
    assert np.array_equal(mesh.point_data["velocity"][:, :2], FIELDS["velocity"])


@pytest.mark.parametrize("dim", [2, 3])
def test_grids_open_in_pyvista(tmp_path, dim):
    pyvista = pytest.importorskip("pyvista")
    shape = (4, 5, 6)[3 - dim :]
    arrays = {"pressure": RNG.random(shape), "velocity": RNG.random((*shape, dim)),
              "solid": RNG.integers(0, 2, shape).astype(np.uint8)}
    cell = np.array([0.1, 0.2, 0.3])[:dim]
    series = XdmfSeries(tmp_path, "grid")
    path = series.write_grid(3, 0.25, Grid(np.ones(dim), cell, arrays))
    assert np.array_equal(read_h5(path)[1]["pressure"].reshape(shape), arrays["pressure"])
    mesh = pyvista.get_reader(tmp_path / "grid.xdmf").read()
    assert mesh.dimensions == (6, 5, 4 if dim == 3 else 1)
    assert np.allclose(mesh.origin[:dim], 1.0 + cell / 2) and np.allclose(mesh.spacing[:dim], cell)
    assert np.array_equal(mesh.point_data["pressure"], arrays["pressure"].ravel())
    assert np.array_equal(mesh.point_data["velocity"][:, :dim], arrays["velocity"].reshape(-1, dim))
    assert np.array_equal(mesh.point_data["solid"], arrays["solid"].ravel())


def test_a_run_leaves_it_where_it_is_asked_for(tmp_path):
    case = {"geometry": {"box": [0.5, 1.0], "periodic": ["x"]}, "particles": {"spacing": 0.125},
            "fluids": {"water": {"density": 1.0, "viscosity": 1.0}}, "flow": "stokes", "drive": {"axes": ["x"]},
            "output": {"format": "xdmf", "grid": "auto", "plots": False}}
    found = api.run(case, out=tmp_path / "out", quiet=True)
    (_, file), = read_series(tmp_path / "out")
    x, fields = read_snapshot(tmp_path / "out" / file)
    assert np.array_equal(x[:, :2], found.x) and np.array_equal(fields["velocity"][:, :2], found.velocity)
    (_, file), = read_series(tmp_path / "out", "grid")
    assert np.array_equal(read_h5(tmp_path / "out" / file)[1]["solid"][0], found.grid().arrays["solid"])
    assert not list((tmp_path / "out").glob("*.pvd"))
