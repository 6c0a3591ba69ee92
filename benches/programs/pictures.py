"""Pictures of compare.py: reading, comparison, and environment maps with one small sun (NumPy, Pillow)."""

import math

import numpy as np
from PIL import Image

# Size of a map with a sun, texels, and side of its sun.
SUN_WIDTH, SUN_SIDE = 512, 3


def display(path, side):
    """Display values, 0 to 1, of a picture over white; larger pictures are averaged down to `side`. And its alpha."""
    values = np.asarray(Image.open(path).convert("RGBA"), np.float64) / 255
    colour, alpha = values[..., :3], values[..., 3:]
    values = np.concatenate([colour * alpha + 1 - alpha, alpha], axis=2)
    factor = values.shape[0] // side
    values = values.reshape(side, factor, side, factor, 4).mean(axis=(1, 3))
    return values[..., :3], values[..., 3]


def linear(values):
    """Linear values of sRGB."""
    return np.where(values <= 0.04045, values / 12.92, ((values + 0.055) / 1.055) ** 2.4)


def psnr(a, b):
    return -10 * math.log10(np.mean((a - b) ** 2))


def compare(path, reference, side):
    """PSNR over the whole picture in display values, and the ratio of the mean linear colours where the reference covers its pixels and both are not clipped."""
    picture, _ = display(path, side)
    truth, alpha = display(reference, side)
    inside = (alpha > 0.99) & (np.maximum(picture, truth).max(axis=2) < 0.995)
    ratio = linear(picture)[inside].mean(axis=0) / linear(truth)[inside].mean(axis=0)
    return psnr(picture, truth), ratio


def write_sun(path, azimuth, elevation):
    """A black .hdr with a white sun of irradiance pi. Returns the direction of its centre in the axes of the capture."""
    height = SUN_WIDTH // 2
    column = round((0.5 - azimuth / 360) * SUN_WIDTH) % SUN_WIDTH
    row = round((0.5 - elevation / 180) * height)
    first = SUN_SIDE // 2
    rows = np.arange(row - first, row - first + SUN_SIDE)
    columns = np.arange(column - first, column - first + SUN_SIDE) % SUN_WIDTH
    solid_angle = SUN_SIDE * sum(math.cos(math.pi * (0.5 - (r + 0.5) / height)) for r in rows) * (2 * math.pi / SUN_WIDTH) * (math.pi / height)
    mantissa, exponent = math.frexp(math.pi / solid_angle)
    texels = np.zeros((height, SUN_WIDTH, 4), np.uint8)
    texels[np.ix_(rows, columns)] = [round(mantissa * 256)] * 3 + [exponent + 128]
    path.write_bytes(f"#?RADIANCE\nFORMAT=32-bit_rle_rgbe\n\n-Y {height} +X {SUN_WIDTH}\n".encode() + texels.tobytes())
    longitude = 2 * math.pi * (0.5 - (column + 0.5) / SUN_WIDTH)
    latitude = math.pi * (0.5 - (row + 0.5) / height)
    return [math.cos(latitude) * math.cos(longitude), math.cos(latitude) * math.sin(longitude), math.sin(latitude)]
