"""What a process holds of an image that is read, and whose walls are found: peak memory above that of the program.

    PYTHONPATH=. python benchmarks/image_memory.py image N FILE.npy      a random body of N^3 voxels
    PYTHONPATH=. mpiexec -n 4 python benchmarks/image_memory.py FILE.npy labels|grey

Prints for each process the fluid sites in some layers of its brick, the MB that are held when the brick is there and
the most so far, above those of the program, and CPU s; of all the sum of the distances, the same for any number of
processes.
"""

import sys
import time
from dataclasses import replace

import numpy as np
import psutil
from scipy import ndimage

CASE = """
geometry:
  voxels: {{file: {file}, {meaning}, voxel_size: 1}}
  periodic: [x, y, z]
particles: {{spacing: 1}}
fluids: {{water: {{density: 1, viscosity: 1}}}}
flow: stokes
drive: {{axes: [x]}}
"""
MEANINGS = {"labels": "labels: {solid: 1, water: 0}", "grey": "grey: {threshold: 128, solid: above, blur: 0.5}"}


def write_image(n, path):
    """Grey values of a random field averaged with a Gaussian of 4 voxels; labels are those above the mean."""
    field = np.random.default_rng(0).standard_normal((n, n, n), np.float32)
    field = ndimage.gaussian_filter(field, 4.0, output=np.float32, mode="wrap")
    grey = np.clip(128.0 + 60.0 / field.std() * field, 0, 255).astype(np.uint8)
    np.save(path, grey)
    np.save(path.replace(".npy", "_labels.npy"), (grey >= 128).astype(np.uint8))


def ask(geometry, lower, upper):
    """(fluid sites, sum of the distances up to 2.1) in some layers of the brick of a process."""
    part, fluid, total = geometry.within(lower, upper, 2.1), 0, 0.0
    sides = [np.arange(np.ceil(a), np.ceil(b)) for a, b in zip(lower, upper)]
    for z in sides[2][::16]:
        x = np.stack(np.meshgrid(*sides[:2], [z], indexing="ij"), axis=-1).reshape(-1, 3) + [0.25, 0.5, 0.75]
        fluid += int((part.phase(x) >= 0).sum())
        total += float(np.clip(part.distance(x), -2.1, 2.1).sum())
    return fluid, total


def main(path, kind):
    from isphcli.case.load import read_case
    from isphcli.domain.communicator import current, join
    from isphcli.domain.cut import even_bricks
    from isphcli.output.environment import launched
    from isphcli.output.machine import peak_memory
    from isphcli.scene.build_geometry import build_geometry

    join(launched())
    file = path if kind == "grey" else path.replace(".npy", "_labels.npy")
    case = read_case(CASE.format(file=file, meaning=MEANINGS[kind]).encode(), "image.yaml")
    small = replace(case, geometry=replace(case.geometry, voxels=replace(case.geometry.voxels, crop=((0, 24),) * 3)))
    ranks = current()
    ask(build_geometry(small), np.zeros(3), np.full(3, 24.0))  # what is imported and compiled
    before, begin = psutil.Process().memory_info().rss, time.process_time()
    geometry = build_geometry(case)
    fluid, total = ask(geometry, *even_bricks(geometry.lower, geometry.upper, ranks.size)[ranks.rank])
    held, seconds = psutil.Process().memory_info().rss, time.process_time() - begin
    rows = ranks.collect((fluid, total, before, held, peak_memory(), seconds))
    if ranks.rank == 0:
        for rank, (own, _, *memory, spent) in enumerate(rows):
            program, now, most = (value / 1e6 for value in memory)
            print(f"process {rank} of {ranks.size}: {own} fluid sites, {now - program:.0f} MB held, "
                  f"{most - program:.0f} MB at most, beside {program:.0f} MB; {spent:.1f} CPU s")
        print(f"all: {sum(row[0] for row in rows)} fluid sites, sum of distances {sum(row[1] for row in rows):.9g}")


if __name__ == "__main__":
    if sys.argv[1] == "image":
        write_image(int(sys.argv[2]), sys.argv[3])
    else:
        main(*sys.argv[1:])
