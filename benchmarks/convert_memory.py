"""Peak memory of converting a large raw image whole, slab by slab.

    PYTHONPATH=. python benchmarks/convert_memory.py [edge] [folder]     512 in a temporary folder without them

Writes a raw image of edge^3 bytes, layer by layer, converts it in a process of its own and prints what that took at
most: `--threshold` to npy, and the labels alone to npz.
"""

import resource
import subprocess
import sys
import tempfile
import time
from pathlib import Path

import numpy as np


def layers(path, edge):
    """A rock of blobs as grey values, one layer in memory at a time."""
    rng = np.random.default_rng(0)
    y, x = np.mgrid[:edge, :edge] * (2.0 * np.pi * round(edge / 32) / edge)
    noise = rng.integers(0, 30, (edge, edge))
    with open(path, "wb") as file:
        for z in range(edge):
            height = 2.0 * np.pi * z / 32
            wave = np.sin(x) * np.cos(y) + np.sin(y) * np.cos(height) + np.sin(height) * np.cos(x)
            file.write(np.clip(128 + 60 * wave + np.roll(noise, 7 * z, axis=0), 0, 255).astype(np.uint8).tobytes())


def main():
    edge = int(sys.argv[1]) if len(sys.argv) > 1 else 512
    with tempfile.TemporaryDirectory(dir=sys.argv[2] if len(sys.argv) > 2 else None) as folder:
        source, rock = Path(folder, f"scan_{edge}x{edge}x{edge}_uint8.raw"), Path(folder, "rock.npy")
        layers(source, edge)
        for arguments in ([source, rock, "--threshold", "140"], [rock, Path(folder, "labels.npz")]):
            start, before = time.perf_counter(), resource.getrusage(resource.RUSAGE_CHILDREN).ru_maxrss
            command = [sys.executable, "-m", "isphcli", "convert-voxels", *map(str, arguments), "--voxel-size", "1e-6"]
            said = subprocess.run(command, check=True, capture_output=True, text=True).stdout
            peak = resource.getrusage(resource.RUSAGE_CHILDREN).ru_maxrss
            most = f"{peak / 2**20:.2f} GB at most" if peak > before else "no more than the one before"
            print(f"{edge}^3 {arguments[1].name}: {most}, {time.perf_counter() - start:.0f} s")
            print("    " + next(line for line in said.splitlines() if line.startswith("connected")))


if __name__ == "__main__":
    main()
