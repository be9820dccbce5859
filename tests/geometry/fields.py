"""Fields whose zero is known: signed distances of planes and spheres, and sums of waves, on voxel centres."""

import numpy as np


def centres(shape, up=1):
    """(z, y, x) coordinates, voxels, of the centres of an image, or of `up` times as many a side."""
    return [(np.arange(n * up) + 0.5) / up for n in shape]


def sphere(n, radius, centre):
    """Distance from a solid sphere, voxels, on n^3 centres; centre: x, y, z."""
    z, y, x = np.meshgrid(*centres((n,) * 3), indexing="ij")
    return np.sqrt((x - centre[0]) ** 2 + (y - centre[1]) ** 2 + (z - centre[2]) ** 2) - radius


def plane(shape, normal, offset, voxel=(1.0, 1.0, 1.0)):
    """normal . x - offset on the centres of an image [z, y, x] with voxels x, y, z; normal: x, y, z, of length one."""
    z, y, x = np.meshgrid(*centres(shape), indexing="ij")
    return normal[0] * x * voxel[0] + normal[1] * y * voxel[1] + normal[2] * z * voxel[2] - offset


def waves(n, longest, shortest, seed, share, up=1):
    """A periodic random field, [z, y, x] on n^3 voxels `up` times finer, above 0 on a share of them.

    Sum of all waves of the box from the longest to the shortest length, voxels, with random amplitudes and phases.
    """
    rng = np.random.default_rng(seed)
    k = np.arange(-(n // shortest), n // shortest + 1)
    waves = np.array([(a, b, c) for a in k for b in k for c in k if n / longest <= np.sqrt(a * a + b * b + c * c) * 1.0
                      <= n / shortest])
    size, phase = rng.standard_normal(len(waves)), rng.uniform(0, 2 * np.pi, len(waves))
    axis = centres((n,), up)[0] / n
    factor = [np.exp(2j * np.pi * np.outer(waves[:, d], axis)) for d in range(3)]
    field = np.einsum("w,wz,wy,wx->zyx", size * np.exp(1j * phase), *factor, optimize=True).real
    return np.quantile(field, share) - field


def phases(field):
    """int8: fluid 0 where the field is positive, else -1."""
    return np.where(field > 0, 0, -1).astype(np.int8)
