"""Prints a patch of known reflectance for `relume calibrate`, from the ground truth of a path-traced scene.

Usage: python3 true_patch.py SCENE

SCENE has held-out views with albedo (sRGB). The patch is the square of 24 pixels (of 400) in the first held-out view with the most even albedo
and the most even light, among those with an albedo above 0.1. Needs numpy and Pillow. Output: `--patch PHOTO:X,Y,WIDTH,HEIGHT --reflectance R,G,B`.
"""

import sys
from pathlib import Path

import numpy
from PIL import Image

VIEW = "test_000"


def main():
    if len(sys.argv) != 2:
        sys.exit(__doc__)
    pixels = numpy.asarray(Image.open(Path(sys.argv[1]) / VIEW / "albedo.png")).astype(float) / 255
    colour, alpha = pixels[..., :3], pixels[..., 3]
    shown = numpy.asarray(Image.open(Path(sys.argv[1]) / VIEW / "rgba.png")).astype(float)[..., :3] / 255
    linear = numpy.where(colour <= 0.04045, colour / 12.92, ((colour + 0.055) / 1.055) ** 2.4)
    side = max(4, pixels.shape[1] * 24 // 400)
    best = (numpy.inf, 0, 0)
    for y in range(0, pixels.shape[0] - side, side // 2):
        for x in range(0, pixels.shape[1] - side, side // 2):
            part = linear[y : y + side, x : x + side]
            if alpha[y : y + side, x : x + side].min() == 1 and part.mean() > 0.1:
                lit = shown[y : y + side, x : x + side]
                spread = part.std((0, 1)).max() / part.mean() + lit.std((0, 1)).max() / max(lit.mean(), 0.05)
                best = min(best, (spread, x, y))
    spread, x, y = best
    if not spread < numpy.inf:
        sys.exit(f"{VIEW} has no opaque square of {side} pixels that is bright enough")
    mean = linear[y : y + side, x : x + side].mean((0, 1))
    print(f"--patch {VIEW}/rgba.png:{x},{y},{side},{side} --reflectance {','.join(f'{v:.4f}' for v in mean)}")


main()
