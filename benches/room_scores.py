"""Scores a model of the room of room.py on its held-out views (numpy, Pillow).

Usage: python3 room_scores.py RELUME MODEL ROOM OUT

RELUME is the program, ROOM the folder `OUT` of room.py, OUT a folder for the rendered frames. Prints the PSNR of whole novel views by both
branches; on table and things the PSNR under the other light, also after one gain per channel in linear light, and the ratio of the
recovered albedo to the true one by channel (median); on the table top the mean albedo where things take at least 40 % of the light, relative to
where they take less than 5 %.
"""

import json
import subprocess
import sys
from pathlib import Path

import numpy
from PIL import Image


def display(file):
    """RGB on white, 0 to 1."""
    picture = numpy.asarray(Image.open(file).convert("RGBA"), float) / 255
    return picture[..., :3] * picture[..., 3:] + 1 - picture[..., 3:]


def linear(values):
    return numpy.where(values <= 0.04045, values / 12.92, ((values + 0.055) / 1.055) ** 2.4)


def encoded(values):
    values = numpy.clip(values, 0, 1)
    return numpy.where(values <= 0.0031308, values * 12.92, 1.055 * values ** (1 / 2.4) - 0.055)


def psnr(a, b):
    return -10 * numpy.log10(numpy.mean((a - b) ** 2))


def main(program, model, room, out):
    views = sorted((room / "room").glob("test_*"))
    out.mkdir(parents=True, exist_ok=True)
    height, width = display(views[0] / "rgba.png").shape[:2]
    common = [program, "render", model, "--path", room / "room/held_out.json", "--resolution", f"{width}x{height}", "--device", "cpu"]
    for name, options in {
        "shaded": [],
        "radiance": ["--output", "radiance"],
        "albedo": ["--output", "albedo"],
        "other": ["--env", room / "other.hdr", "--tier", "high"],
    }.items():
        command = [*common, *options, "--out", out / f"{name}%04d.png"]
        subprocess.run([str(part) for part in command], check=True, capture_output=True)
    rows = {name: [] for name in ("novel", "radiance", "relit", "relit_aligned", "albedo_ratio", "shadow")}
    for k, view in enumerate(views):
        frame = {name: display(out / f"{name}{k + 1:04d}.png") for name in ("shaded", "radiance", "albedo", "other")}
        photograph, truth = display(view / "rgba.png"), display(view / "rgba_other.png")
        shown, top = (display(view / f"{name}.png")[..., 0] > 0.9 for name in ("mask", "table"))
        rows["novel"].append(psnr(frame["shaded"], photograph))
        rows["radiance"].append(psnr(frame["radiance"], photograph))
        rows["relit"].append(psnr(frame["other"][shown], truth[shown]))
        ours, true = linear(frame["other"][shown]), linear(truth[shown])
        gain = numpy.median(true / numpy.maximum(ours, 1e-3), axis=0)
        rows["relit_aligned"].append(psnr(encoded(ours * gain), truth[shown]))
        albedo = linear(frame["albedo"])
        rows["albedo_ratio"].append(numpy.median(albedo[shown] / numpy.maximum(linear(display(view / "albedo.png")[shown]), 1e-3), axis=0))
        kept = linear(photograph).mean(-1) / numpy.maximum(linear(display(view / "without.png")).mean(-1), 1e-3)
        shaded, beside = top & (kept < 0.6), top & (kept > 0.95)
        if shaded.sum() > 50 and beside.sum() > 50:
            rows["shadow"].append(albedo[shaded].mean() / albedo[beside].mean())
    print(json.dumps({name: numpy.round(numpy.mean(values, axis=0), 3).tolist() for name, values in rows.items()}))


if __name__ == "__main__":
    if len(sys.argv) != 5:
        sys.exit(__doc__)
    main(sys.argv[1], sys.argv[2], Path(sys.argv[3]), Path(sys.argv[4]))
