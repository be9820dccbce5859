"""A coarse hash of a picture: what is where, not the pixels of one driver."""

import numpy as np

CELLS = (9, 12)  # rows and columns of the mean colours that are compared


def coarse(image):
    """Mean colours (9, 12, 3), 0 to 1, of an image (height, width, 3) of bytes."""
    rows, columns = (np.array_split(np.arange(n), k) for n, k in zip(image.shape, CELLS))
    cells = [[image[r[0] : r[-1] + 1, c[0] : c[-1] + 1].mean(axis=(0, 1)) for c in columns] for r in rows]
    return np.array(cells) / 255


def digits(image):
    """The hash as text: a digit 0 to 9 for each colour of each cell."""
    return "".join(map(str, np.rint(9 * coarse(image)).astype(int).ravel()))


def apart(image, text):
    """Mean and largest difference of a picture from a hash, of colours 0 to 1; rounding of the digits is 0.03, 0.06."""
    known = np.array(list(text), int).reshape(*CELLS, 3) / 9
    difference = np.abs(coarse(image) - known)
    return float(difference.mean()), float(difference.max())
