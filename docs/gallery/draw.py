"""Draws the pictures of the gallery and of README.md, each from a case of cases/.

    python docs/gallery/draw.py                 all
    python docs/gallery/draw.py berea           one
    python docs/gallery/draw.py --commands      only prints the commands
"""

from __future__ import annotations

import subprocess
import sys
import tempfile
from pathlib import Path

from PIL import Image

ROOT = Path(__file__).resolve().parents[2]
WIDTH = 900  # pixels; wider ones are made smaller
COLOURS = 96  # of the palette, with which a picture takes some 50 kB
PICTURES = {  # {name of a case: (picture of its run, what is changed in it so that it takes a minute or two at most)}
    "berea": ("slice.png", ()),
    "grey_blobs": ("slice.png", ("particles.spacing=1.5e-6",)),
    "sphere_array": ("slice.png", ()),
    "cylinder_array": ("slice.png", ()),
    "taylor_couette": ("slice.png", ()),
    "lid_driven_cavity": ("slice.png", ()),
    "rising_bubble": ("phases.png", ()),
    "drop_wall_60": ("phases.png", ()),
    "slit_drainage": ("phases.png", ()),
}


def command(name: str) -> list[str]:
    """The arguments of `isph` that run the case of a picture."""
    return ["run", f"cases/{name}.yaml", *(word for change in PICTURES[name][1] for word in ("--set", change))]


def draw(name: str) -> Path:
    """Runs the case of a picture and keeps it, smaller; the file."""
    target = ROOT / f"docs/gallery/{name}.png"
    with tempfile.TemporaryDirectory() as folder:
        subprocess.run([sys.executable, "-m", "isphcli", *command(name), "--quiet", "--out", f"{folder}/run"], cwd=ROOT,
                       check=True, stdout=subprocess.DEVNULL)
        image = Image.open(Path(folder, "run", PICTURES[name][0])).convert("RGB")
    if image.width > WIDTH:
        image = image.resize((WIDTH, round(image.height * WIDTH / image.width)), Image.Resampling.LANCZOS)
    image.quantize(COLOURS, dither=Image.Dither.NONE).save(target, optimize=True)
    return target


def main(words: list[str]) -> None:
    """Draws what is named, or everything."""
    for name in [word for word in words if not word.startswith("-")] or PICTURES:
        print("isph", " ".join(f"'{word}'" if "[" in word else word for word in command(name)), flush=True)
        if "--commands" not in words:
            print(f"  {draw(name).stat().st_size / 1000:.0f} kB", flush=True)


if __name__ == "__main__":
    main(sys.argv[1:])
