"""From the words of a case to its geometry, and what is said of it."""

import numpy as np

from isphcli.scene.build_geometry import build_geometry
from tests.geometry.images.files import read


def test_image_of_a_case(tmp_path):
    values = np.array([[[0, 1, 2]] * 4] * 5, np.uint8)
    np.save(tmp_path / "a.npy", values)
    scene = "{voxels: {file: a.npy, labels: {solid: 1, brine: 0, co2: 2}, voxel_size: 0.5}, periodic: [z]}"
    g = build_geometry(read(tmp_path, scene))
    assert g.periodic == (False, True, True) and g.upper.tolist() == [1.5, 4, 2.5]  # two clear voxels a side
    assert g.phase(np.array([[0.2, 2, 1], [0.7, 2, 1], [1.2, 2, 1], [0.7, 0.5, 1]])).tolist() == [0, -1, 1, 0]
    along_z = build_geometry(read(tmp_path, scene), axis=2)
    assert along_z.periodic == (False, False, True) and along_z.upper.tolist() == [1.5, 2, 2.5]


def test_what_is_said_of_an_image(tmp_path):
    image = np.ones((4, 5, 6), np.uint8)
    image[:, :, 1:] = 0
    np.save(tmp_path / "a.npy", image)
    voxels = "{voxels: {file: a.npy, labels: {solid: [1], brine: 0}, voxel_size: 1e-6, AXES}}"
    g = build_geometry(read(tmp_path, voxels.replace("AXES", "axes: xyz, crop: [[0, 3], [0, 5], [0, 6]]")))
    said = dict(g.described)
    assert said["image"] == ("3 x 5 x 6 voxels along x, y, z, cropped from 4 x 5 x 6; a.npy is an array 4 x 5 x 6, "
                             "its axes taken as x, y, z")  # fmt: skip
    assert said["porosity"] == "83.33 % of the image's voxels (solid 1, brine 0)"
    assert g.warnings == ("porosity 83.3 %: more than rock has; check which values are solid (solid 1, brine 0; the "
                          "other way round it is 16.7 %)",)  # fmt: skip
    g = build_geometry(read(tmp_path, voxels.replace("AXES", "axes: zyx")))
    assert dict(g.described)["image"].startswith("6 x 5 x 4 voxels along x, y, z; a.npy is an array 4 x 5 x 6, its "
                                                 "axes taken as z, y, x")  # fmt: skip


def test_shapes_of_a_case(tmp_path):
    (tmp_path / "b.csv").write_text("x,y,z\n0.5,0.5,0.5\n")
    scene = """
  box: [1, 1, 1]
  origin: [0, 0, 0.25]
  periodic: [x, y]
  slip_length: 0.01
  walls: {z_max: {velocity: [1, 0, 0]}}
  shapes:
    - {spheres: {file: b.csv, radius: 0.1}, is: solid}
    - {cylinder: {axis: x, radius: 0.4}, outside: true, is: co2}
    - {box: {lower: [0, 0, 0], upper: [1, 0.1, 2]}, is: solid, slip_length: 0.1}"""
    g = build_geometry(read(tmp_path, scene))
    assert g.lower.tolist() == [0, 0, 0.25] and g.periodic == (True, True, False)
    x = np.array([[0.5, 0.5, 0.5], [0.5, 0.5, 0.75], [0.1, 0.15, 0.3], [0.1, 0.05, 0.6], [0.1, 0.5, 1.24]])
    assert g.phase(x).tolist() == [-1, 0, 1, -1, 1]
    assert g.wall_velocity[g.wall(x[4:])].tolist() == [[1, 0, 0]]
    assert g.slip_length[g.wall(x[3:])].tolist() == [0.1, 0.01]
