"""In a pipeline of PoreSpy: an image that it generates, and the permeability of its flow beside what it measures.

    pip install porespy
    python examples/porespy_pipeline.py

PoreSpy's images are [x, y, z], True in the pores: `order="xyz"` and `solid=False` say so.
"""

import numpy as np
import porespy

import isphcli

VOXEL = 2e-6  # m


def main(size: int = 50, porosity: float = 0.6, quiet: bool = False) -> tuple[isphcli.RunResult, float]:
    """The flow along x through blobs of `size` voxels an edge, and the median diameter of the pores, m, by PoreSpy."""
    image = porespy.generators.blobs([size] * 3, porosity=porosity, blobiness=1, seed=3)
    found = isphcli.permeability(image, voxel_size=VOXEL, axis="x", order="xyz", solid=False, quiet=quiet,
                                 options={"measure": ["formation_factor"]})
    thickness = porespy.filters.local_thickness(image)  # radius of the largest ball that holds a voxel, voxels
    diameter = 2.0 * VOXEL * float(np.median(thickness[image]))
    if not quiet:
        print(found)
        print(f"median diameter of the pores by PoreSpy: {diameter:.3g} m")
    return found, diameter


if __name__ == "__main__":
    main()
