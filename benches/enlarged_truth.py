"""Prints the PSNR of pictures that were reduced to half their size and enlarged again: what photographs at twice the distance hold of them.

Usage: python3 enlarged_truth.py SIDE PICTURE...

The pictures (PNG with alpha) are drawn over white and resampled to SIDE pixels; the last line is the mean. Requires NumPy and Pillow.
"""

import sys

import numpy as np
from PIL import Image


def over_white(file, side):
    """The picture over white, `side` pixels wide and high."""
    values = np.asarray(Image.open(file).convert("RGBA"), np.float32) / 255
    shown = values[..., :3] * values[..., 3:] + 1 - values[..., 3:]
    return Image.fromarray((shown * 255 + 0.5).astype("uint8")).resize((side, side), Image.LANCZOS)


def psnr(file, side):
    """PSNR of the reduced and enlarged picture against the picture, dB."""
    picture = over_white(file, side)
    enlarged = picture.resize((side // 2, side // 2), Image.BOX).resize((side, side), Image.BICUBIC)
    difference = (np.asarray(picture, np.float32) - np.asarray(enlarged, np.float32)) / 255
    return -10 * np.log10(np.mean(difference**2))


if __name__ == "__main__":
    if len(sys.argv) < 3:
        sys.exit(__doc__)
    values = [psnr(file, int(sys.argv[1])) for file in sys.argv[2:]]
    print("\n".join(f"{value:.2f}" for value in [*values, np.mean(values)]))
