"""Compares frames of `relume render` with the pictures of references.py and prints Markdown tables.

Usage: python3 scores.py REFERENCES MODEL MAP MAP WORK [--relume PROGRAM] [--kinds ground,lamps,materials] [--sheets]

REFERENCES is the folder of references.py, MODEL a model that was trained from a capture of the same scene (elsewhere.py or lights.py), MAP the maps of the
references. WORK gets the frames; with --sheets (needs Pillow) also PNG files with reference, frame and difference side by side. Needs numpy and OpenEXR.

- ground: the ratio of the plane with and without the scene against `shadow` + `bounce`, linear, peak 1; in the whole picture, where the ratio (mean of the
  channels) differs from 1 by more than 0.05, and there without any shadow. The plane at the lowest point is compared at the default height of `relume render` and at
  its true height; that in place of the table at a `--ground-height` 0.01 above the table, because the model contains the table.
- lamps and materials: pictures on white, sRGB curve, limited to 1. The gain of a lamp is one factor per channel for all views of the tier: the median of
  reference over frame where both are above 0.02. Controls: the lamp on the other side, no lamp, the model without the change.
- A material counts as part of what changes if more than half of its pixels show that; its pixels are found by making it black (`--recolour 'N*=0'`).

PSNR in dB, the mean of the views. A value that is not finite ends the program with an error.
"""

import argparse
import json
import math
import subprocess
import sys
from pathlib import Path

import common
import numpy
import OpenEXR

REPOSITORY = Path(__file__).resolve().parents[2]
TIERS = ("standard", "high")
# Least difference of the ratio from 1 in a shadow.
SHADOW = 0.05
# Distance of `--ground-height` above a table, units of the capture. The scenes have a radius of 1.2.
ABOVE_TABLE = 0.01
# Least linear value for a gain, and least number of such pixels.
LEAST, LEAST_PIXELS = 0.02, 100
# Share of the pixels of a material that decides whether it belongs to what changes, and least share of what changes that it covers.
MOST, LEAST_COVER = 0.5, 0.01
DARK = ("--env", "white", "--exposure", "-20")


def channels(file):
    """Channels of an EXR file, all parts, by name."""
    found = {}
    with OpenEXR.File(str(file), separate_channels=True) as opened:
        for part in opened.parts:
            found |= {name: numpy.array(channel.pixels, dtype=float) for name, channel in part.channels.items()}
    return found


def planes(file, names="RGBA"):
    """Channels of an EXR file as one array; every value must be finite."""
    found = channels(file)
    picture = numpy.stack([found[name] for name in names], -1)
    if not numpy.isfinite(picture).all():
        sys.exit(f"{file} has values that are not finite")
    return picture


def psnr(true, ours, where=None):
    """PSNR of two arrays with peak 1, dB."""
    error = (true - ours) ** 2 if where is None else (true - ours)[where] ** 2
    if not error.size or not numpy.isfinite(error).all() or error.mean() <= 0:
        sys.exit("a comparison has no pixels, no finite values, or no difference at all")
    return -10 * math.log10(error.mean())


def shown(picture, gain=(1.0, 1.0, 1.0)):
    """A premultiplied linear picture on white, with the sRGB curve."""
    light = picture[..., :3] * numpy.array(gain) + 1 - picture[..., 3:]
    light = light.clip(0, 1)
    return numpy.where(light <= 0.0031308, 12.92 * light, 1.055 * light ** (1 / 2.4) - 0.055)


def mean(values):
    return sum(values) / len(values)


class Bench:
    """References, model and frames."""

    def __init__(self, args):
        self.args = args
        self.facts = json.loads((args.references / "references.json").read_text())
        self.views = range(self.facts["views"])
        self.maps = dict(zip(self.facts["maps"], args.maps))
        if [file.stem for file in args.maps] != self.facts["maps"]:
            sys.exit(f"the references have the maps {', '.join(self.facts['maps'])}, in this order")
        self.scene = self.facts["scene"]

    def reference(self, name, names="RGBA"):
        return planes(self.args.references / name, names)

    def frames(self, name, *options, names="RGBA"):
        """Frames of all views, by `relume render`."""
        folder = self.args.work / name
        folder.mkdir(parents=True, exist_ok=True)
        cameras = ["--path", self.args.references / "cameras.json", "--colour-depth", "float", "--start-number", 0]
        command = [self.args.relume, "render", self.args.model, *cameras, *options, "--out", f"{folder}/%04d.exr"]
        done = subprocess.run(list(map(str, command)), capture_output=True, text=True)
        if done.returncode:
            sys.exit(f"{' '.join(map(str, command))} failed:\n{done.stderr[-2000:]}")
        return [planes(folder / f"{view:04d}.exr", names) for view in self.views]

    def sheet(self, name, true, ours):
        """Reference, frame and difference times 4, a row per view."""
        if not self.args.sheets:
            return
        from PIL import Image

        rows = [numpy.concatenate([a, b, (4 * abs(a - b)).clip(0, 1)], 1) for a, b in zip(true, ours)]
        picture = (255 * numpy.concatenate(rows).clip(0, 1)).round().astype(numpy.uint8)
        Image.fromarray(picture).save(self.args.work / f"{name.replace(' ', '-')}.png")


def table(heads, rows):
    """A Markdown table; columns after the second are numbers."""
    lines = [heads, ["---", "---", *["---:"] * (len(heads) - 2)], *rows]
    print("\n" + "\n".join("| " + " | ".join(row) + " |" for row in lines), flush=True)


def several(values):
    return ", ".join(f"{v:.1f}" for v in values)


def ground_row(bench, place, light, above):
    """Scores of the plane at a place under a map. The ground of the frames lies `above` the true one; None: at the default height."""
    names = [f"{output}.{channel}" for output in ("shadow", "bounce") for channel in "RGB"]
    height = [] if above is None else ["--ground-height", bench.facts["planes"][place] + above]
    name = f"ground-{place}-{light}{'-default' if above is None else ''}"
    both = bench.frames(name, "--env", bench.maps[light], "--output", "rgb,shadow,bounce", *height, names=names)
    ours = [values[..., :3] + values[..., 3:] for values in both]
    true, inside = [], []
    # Without the scene the plane has one colour, because it is diffuse and the light is distant.
    plane = bench.reference(common.plane_file(light), "RGB").mean((0, 1))
    if plane.min() <= 0:
        sys.exit(f"{light}: the plane without the scene is black")
    for view in bench.views:
        true.append(bench.reference(common.ground_file(place, light, view), "RGB") / plane)
        inside.append(abs(true[-1].mean(-1) - 1) > SHADOW)
    bench.sheet(name, true, ours)
    whole = [psnr(a, b) for a, b in zip(true, ours)]
    within = [psnr(a, b, where) for a, b, where in zip(true, ours, inside)]
    without = [psnr(a, numpy.ones_like(a), where) for a, where in zip(true, inside)]
    share = f"{100 * mean([where.mean() for where in inside]):.0f} %"
    where = "default" if above is None else f"{place} + {above:g}"
    return [bench.scene, f"`{light}`", where, several(whole), several(within), several(without), share]


def ground(bench):
    """Shadow and bounced light of the plane below the scene."""
    heights = [(place, above) for place in bench.facts["planes"] for above in ((None, 0.0) if place == "lowest" else (ABOVE_TABLE,))]
    rows = [ground_row(bench, place, light, above) for place, above in heights for light in bench.maps]
    table(["object", "light", "height of the ground", "whole picture, dB", f"ratio differs by more than {SHADOW}, dB", "there without a shadow, dB", "share of the picture"], rows)


def gain_of(true, ours):
    """One factor per channel for all views."""
    gains = []
    for channel in range(3):
        pairs = [(a[..., channel], b[..., channel]) for a, b in zip(true, ours)]
        ratios = numpy.concatenate([a[(a > LEAST) & (b > LEAST)] / b[(a > LEAST) & (b > LEAST)] for a, b in pairs])
        if ratios.size < LEAST_PIXELS:
            sys.exit("too few pixels are lit for a gain")
        gains.append(float(numpy.median(ratios)))
    return gains


def lamps(bench):
    """The scene under one lamp."""
    rows, off = [], bench.frames("lamps-off", *DARK)
    for name, lamp in common.LAMPS.items():
        true = [bench.reference(common.lamp_file(name, view)) for view in bench.views]
        row, gains = [], []
        for tier in TIERS:
            ours = bench.frames(f"lamps-{name.replace(' ', '-')}-{tier}", *DARK, "--tier", tier, "--lamp", common.lamp_text(lamp))
            gain = gain_of(true, ours)
            bench.sheet(f"lamps-{name}-{tier}", map(shown, true), map(shown, ours))
            pairs = [[psnr(shown(a), shown(b, g)) for a, b in zip(true, ours)] for g in ((1.0,) * 3, gain)]
            row.append(", ".join(f"{mean(values):.1f}" for values in pairs))
            gains.append(" ".join(f"{g:.2f}" for g in gain))
        elsewhere = bench.frames(f"lamps-{name.replace(' ', '-')}-mirrored", *DARK, "--lamp", common.lamp_text(common.mirrored(lamp)))
        controls = [mean([psnr(shown(a), shown(b)) for a, b in zip(true, other)]) for other in (elsewhere, off)]
        rows.append([bench.scene, name, *row, gains[-1], *(f"{v:.1f}" for v in controls)])
    heads = ["object", "lamp", *(f"`{tier}`: as recovered, with gains" for tier in TIERS), f"gains (`{TIERS[-1]}`)"]
    table([*heads, "lamp on the other side", "no lamp"], rows)


def changed_materials(bench, light):
    """Numbers of the materials of what changes, and the share of it that they cover."""
    masks = [bench.reference(common.mask_file(view), "A")[..., 0] for view in bench.views]
    albedo = [f"albedo.{channel}" for channel in "RGB"]
    options = ("--env", bench.maps[light], "--output", "rgb,albedo")
    before = bench.frames("albedo", *options, names=[*albedo, "A"])
    listed = subprocess.run([bench.args.relume, "materials", bench.args.model], capture_output=True, text=True)
    if listed.returncode:
        sys.exit(f"relume materials failed:\n{listed.stderr[-2000:]}")
    chosen, covered = [], 0.0
    whole = sum((mask * a[..., 3]).sum() for mask, a in zip(masks, before))
    for number in range(len(listed.stdout.strip().splitlines()) - 1):
        black = bench.frames(f"albedo-{number}", *options, "--recolour", f"{number}*=0", names=[*albedo, "A"])
        shares = [
            (1 - b[..., :3].sum(-1) / numpy.maximum(a[..., :3].sum(-1), 1e-6)).clip(0, 1) * a[..., 3] for a, b in zip(before, black)
        ]
        inside = sum((share * mask).sum() for share, mask in zip(shares, masks))
        total = sum(share.sum() for share in shares)
        if total > 0 and inside / total > MOST and inside / whole > LEAST_COVER:
            chosen.append(number)
            covered += inside / whole
    if not chosen:
        sys.exit("no material of the model belongs to what changes")
    return chosen, covered


def materials(bench):
    """The scene with a material in another colour."""
    numbers, covered = changed_materials(bench, next(iter(bench.maps)))
    change = ",".join(f"{number}={common.NEW_COLOUR}" for number in numbers)
    rows = []
    for light, file in bench.maps.items():
        true = [[bench.reference(common.material_file(light, view, is_changed)) for view in bench.views] for is_changed in (False, True)]
        ours = [bench.frames(f"materials-{light}", "--env", file), bench.frames(f"materials-{light}-changed", "--env", file, "--recolour", change)]
        bench.sheet(f"materials-{light}", map(shown, true[0]), map(shown, ours[0]))
        bench.sheet(f"materials-{light}-changed", map(shown, true[1]), map(shown, ours[1]))
        scores = [mean([psnr(shown(a), shown(b)) for a, b in zip(true[i], ours[k])]) for i, k in ((0, 0), (1, 1), (1, 0))]
        rows.append([bench.scene, f"`{light}`", *(f"{v:.1f}" for v in scores), f"`{change}`", f"{100 * covered:.0f} %"])
    heads = ["object", "light", "as it is, dB", "changed, dB", "changed against the unchanged model, dB", "`--recolour`", "share of what changes in these materials"]
    table(heads, rows)


def arguments():
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    for name in ("references", "model"):
        parser.add_argument(name, type=Path)
    parser.add_argument("maps", nargs=2, type=Path)
    parser.add_argument("work", type=Path)
    parser.add_argument("--relume", default=str(REPOSITORY / "target/release/relume"), help="the program")
    parser.add_argument("--kinds", type=lambda text: text.split(","), help="default: all of the references")
    parser.add_argument("--sheets", action="store_true")
    return parser.parse_args()


def main():
    args = arguments()
    bench = Bench(args)
    kinds = args.kinds or bench.facts["kinds"]
    if not set(kinds) <= set(bench.facts["kinds"]):
        sys.exit(f"the references have {', '.join(bench.facts['kinds'])}")
    steps = {"ground": ground, "lamps": lamps, "materials": materials}
    print(f"{bench.scene}, {bench.facts['side']} px, {len(bench.views)} views, Blender {bench.facts['blender']}, samples {bench.facts['samples']}")
    for kind in kinds:
        steps[kind](bench)


if __name__ == "__main__":
    main()
