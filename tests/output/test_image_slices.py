"""The picture of three slices: it is drawn, and shows the labels where they are."""

import numpy as np
import pytest

from isphcli.output.image_slices import plot_slices
from isphcli.output.plots import SOLID


def shares(path):
    """Part of the picture in the colour of solids."""
    from PIL import Image

    pixels = np.asarray(Image.open(path).convert("RGB"))
    wanted = [int(SOLID[k : k + 2], 16) for k in (1, 3, 5)]
    return float((pixels == wanted).all(axis=-1).mean())


@pytest.mark.slow
@pytest.mark.parametrize("shape", [(6, 8, 10), (8, 10)])
@pytest.mark.parametrize("spacing", [None, 2e-6])
def test_solids_are_drawn_in_their_colour(tmp_path, shape, spacing):
    """With twice the solid, twice the area: within 20 %, the legend and antialiased edges."""
    found = []
    for share in (0.25, 0.5):
        values = np.zeros(shape, np.uint8)
        values.reshape(-1, shape[-2] * shape[-1])[:, : round(share * shape[-2] * shape[-1])] = 1
        edges = None if spacing is None else (spacing,) * len(shape)
        plot_slices(tmp_path / "a.png", values, [1], edges, "rock")
        found.append(shares(tmp_path / "a.png"))
    assert found[1] / found[0] == pytest.approx(2.0, rel=0.2)


def test_many_values_are_drawn_as_grey_values(tmp_path):
    plot_slices(tmp_path / "a.png", np.arange(512).reshape(8, 8, 8), [1], None)
    assert (tmp_path / "a.png").stat().st_size > 5000
