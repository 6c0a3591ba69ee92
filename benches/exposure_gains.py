"""Copies a path-traced scene and gives its training photographs random gains, as of automatic exposure and white balance.

Usage: python3 exposure_gains.py SCENE OUT SPREAD

SPREAD is the standard deviation of ln(gain) in green; that of red and of blue over green is 0.45 of it. The geometric mean of the
gains is 1: a capture that is brighter in the mean has brighter surfaces, which is no error of a training. The random numbers have a
fixed seed. Files other than training photographs become links to SCENE. OUT must not exist. Requires NumPy and Pillow.
"""

import sys
from pathlib import Path

import numpy as np
from PIL import Image

SEED = 7
WHITE_BALANCE_SHARE = 0.45


def linear(values):
    """The sRGB curve, IEC 61966-2-1, from display values to linear light."""
    return np.where(values <= 0.04045, values / 12.92, ((values + 0.055) / 1.055) ** 2.4)


def displayed(values):
    """The inverse of `linear`."""
    return np.where(values <= 0.0031308, values * 12.92, 1.055 * np.maximum(values, 1e-9) ** (1 / 2.4) - 0.055)


def with_gain(image, gain):
    """`image` with its linear colours multiplied by `gain`, clipped at white."""
    values = np.asarray(image, float) / 255
    values[..., :3] = displayed(np.clip(linear(values[..., :3]) * gain, 0, 1))
    return Image.fromarray((values * 255 + 0.5).astype("uint8"), image.mode)


def gains(count, spread):
    """Random gains of `count` photographs, red, green and blue, with a geometric mean of 1."""
    rng = np.random.default_rng(SEED)
    green = rng.normal(0, spread, (count, 1))
    over_green = rng.normal(0, WHITE_BALANCE_SHARE * spread, (count, 2))
    logs = np.concatenate([green + over_green[:, :1], green, green + over_green[:, 1:]], 1)
    return np.exp(logs - logs.mean(0))


def copy(scene, out, spread):
    """Writes the copy of `scene` to the new folder `out`."""
    out.mkdir(parents=True)
    entries = sorted(scene.iterdir())
    trained = [entry for entry in entries if entry.name.startswith("train_")]
    for entry in entries:
        if entry not in trained:
            (out / entry.name).symlink_to(entry.resolve())
    for entry, gain in zip(trained, gains(len(trained), spread)):
        (out / entry.name).mkdir()
        for file in entry.iterdir():
            target = out / entry.name / file.name
            if file.name == "rgba.png":
                with_gain(Image.open(file), gain).save(target)
            else:
                target.symlink_to(file.resolve())


if __name__ == "__main__":
    if len(sys.argv) != 4:
        sys.exit(__doc__)
    copy(Path(sys.argv[1]), Path(sys.argv[2]), float(sys.argv[3]))
