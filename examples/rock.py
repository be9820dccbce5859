"""Rock to permeability: a piece of Berea sandstone, its permeability with what it is worth, and its flow on a grid.

    python examples/rock.py
"""

from pathlib import Path

import numpy as np

import isphcli

CASES = Path(__file__).parents[1] / "cases"


def main(size: int = 64, quiet: bool = False) -> isphcli.RunResult:
    """The permeability along x of a cube of `size` voxels."""
    image = np.load(CASES / "data/berea_128.npz")["image"][:size, :size, :size]  # [z, y, x], 1 solid
    found = isphcli.permeability(image, voxel_size=3e-6, axis="x", quiet=quiet)
    if not quiet:
        print(found)
        velocity = found.grid().arrays["velocity"]  # [z, y, x, 3], clear layers before and behind the rock included
        print(f"share of the voxels where the fluid flows backwards: {(velocity[..., 0] < 0).mean():.1%}")
        found.plot().save("rock.png")
    return found


if __name__ == "__main__":
    main()
