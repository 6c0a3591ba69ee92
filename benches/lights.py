"""Path-traces the scenes of elsewhere.py under lights of many kinds, with Cycles (bpy 5.0), in the layout of TensoIR-Synthetic.

Usage: python3 lights.py SCENE LIGHT OUT [SIDE]

SCENE is `monkey`, `blocks` or `cloth`. LIGHT is the light of the 60 photographs: `softboxes` (three soft boxes of 10 to 25 degrees in a dark studio),
`lamps` (two small lamps in a dim room), `sunset` (a sun 12 degrees above the horizon), `neon` (two coloured tubes and a white one), or `window` (one large
window). OUT gets 60 photographs, six held-out views with albedo and with the picture under each of the other lights, and OUT/envmaps/LIGHT.hdr.
OUT must not exist. SIDE is the width and height of the pictures, pixels; omitted: 160, which takes about four minutes on two cores.
"""

import json
import sys
from pathlib import Path

import bpy
import elsewhere
import numpy

SIDE = 160
WIDTH, HEIGHT = 512, 256
ALBEDO_SAMPLES = 8

# Irradiance of a surface facing up, mean of the channels, by light: photographers expose differently.
LEVELS = {"softboxes": 2.9, "lamps": 2.3, "sunset": 2.2, "neon": 2.6, "window": 2.6}


def directions():
    """Directions of the texels (HEIGHT, WIDTH, 3), +Z up, and their solid angles (HEIGHT, 1)."""
    polar = (numpy.arange(HEIGHT) + 0.5) / HEIGHT * numpy.pi
    azimuth = numpy.pi * (1 - (numpy.arange(WIDTH) + 0.5) / WIDTH * 2)
    across, up = numpy.sin(polar)[:, None], numpy.cos(polar)[:, None]
    towards = numpy.stack(
        [across * numpy.cos(azimuth), across * numpy.sin(azimuth), up + 0 * azimuth[None]], -1
    )
    return towards, across * (numpy.pi / HEIGHT) * (2 * numpy.pi / WIDTH)


TOWARDS, SOLID_ANGLES = directions()


def axis(azimuth, elevation):
    """Unit vector of angles in degrees."""
    a, e = numpy.radians(azimuth), numpy.radians(elevation)
    return numpy.array([numpy.cos(e) * numpy.cos(a), numpy.cos(e) * numpy.sin(a), numpy.sin(e)])


def panel(azimuth, elevation, width, height, colour):
    """A rectangle of radiance `colour` that is seen under `width` x `height` degrees."""
    middle = axis(azimuth, elevation)
    right = numpy.cross([0, 0, 1], middle)
    right /= numpy.linalg.norm(right)
    depth = TOWARDS @ middle
    x, y = (numpy.degrees(numpy.arctan2(TOWARDS @ side, depth)) for side in (right, numpy.cross(middle, right)))
    inside = (depth > 0) & (abs(x) < width / 2) & (abs(y) < height / 2)
    return inside[..., None] * numpy.array(colour)


def room(above, below):
    """A smooth surrounding between two colours."""
    share = (TOWARDS[..., 2:] + 1) / 2
    return share * numpy.array(above) + (1 - share) * numpy.array(below)


def light(name):
    """Radiance (HEIGHT, WIDTH, 3) of a light, at its level."""
    if name == "softboxes":
        radiance = room((0.06, 0.06, 0.065), (0.04, 0.04, 0.04))
        radiance += panel(35, 48, 25, 25, (14, 14, 14.5)) + panel(160, 30, 10, 20, (12, 11.5, 11)) + panel(275, 60, 15, 15, (9, 9, 9.6))
    elif name == "lamps":
        radiance = room((0.16, 0.12, 0.08), (0.07, 0.05, 0.035))
        radiance += panel(80, 50, 5, 5, (300, 200, 110)) + panel(230, 35, 7, 7, (110, 80, 50))
    elif name == "sunset":
        radiance = room((0.22, 0.32, 0.55), (0.22, 0.17, 0.12)) + panel(300, 12, 60, 20, (0.5, 0.3, 0.12))
        radiance += panel(300, 12, 1.5, 1.5, (9000, 5600, 2700))
    elif name == "neon":
        radiance = room((0.12, 0.1, 0.16), (0.05, 0.05, 0.05))
        radiance += panel(10, 35, 50, 4, (14, 2, 9)) + panel(130, 40, 4, 50, (2, 10, 14)) + panel(250, 65, 40, 4, (18, 17, 15))
    else:
        radiance = room((0.30, 0.29, 0.27), (0.14, 0.12, 0.10)) + panel(120, 28, 55, 40, (4.2, 4.8, 5.6))
    facing_up = (radiance * numpy.clip(TOWARDS[..., 2:], 0, 1) * SOLID_ANGLES[..., None]).sum((0, 1)).mean()
    return radiance * (LEVELS[name] / facing_up)


def write(radiance, file):
    """Writes a Radiance file of linear radiance, in shared exponents (RGBE)."""
    largest = numpy.maximum(radiance.max(-1), 1e-30)
    exponent = numpy.floor(numpy.log2(largest)) + 1
    mantissa = radiance * numpy.exp2(8 - exponent)[..., None]
    texels = numpy.concatenate([mantissa, exponent[..., None] + 128], -1).clip(0, 255).astype(numpy.uint8)
    header = f"#?RADIANCE\nFORMAT=32-bit_rle_rgbe\n\n-Y {HEIGHT} +X {WIDTH}\n"
    file.write_bytes(header.encode() + texels.tobytes())


def show_albedo():
    """Replaces every material by its base colour as emission."""
    for of in bpy.data.materials:
        if not of.use_nodes or "Principled BSDF" not in of.node_tree.nodes:
            continue
        nodes = of.node_tree.nodes
        glow = nodes.new("ShaderNodeEmission")
        glow.inputs[0].default_value = nodes["Principled BSDF"].inputs["Base Color"].default_value
        of.node_tree.links.new(glow.outputs[0], nodes["Material Output"].inputs[0])


def render(out, name, others):
    """Renders photographs and held-out views into `out`. The albedo comes last because it replaces the materials."""
    world = bpy.context.scene.world.node_tree.nodes
    environment = next(node for node in world if node.type == "TEX_ENVIRONMENT")

    def under(of):
        environment.image = bpy.data.images.load(str(out / "envmaps" / f"{of}.hdr"), check_existing=True)

    groups = elsewhere.cameras()
    views = {"train": groups["photographs"], "test": groups["between"]}
    for kind, matrices in views.items():
        frames = []
        for k, matrix in enumerate(matrices):
            folder = out / f"{kind}_{k:03d}"
            under(name)
            elsewhere.photograph(matrix, folder / "rgba.png")
            for other in others if kind == "test" else ():
                under(other)
                elsewhere.photograph(matrix, folder / f"rgba_{other}.png")
            frames.append({"file_path": f"./{folder.name}/rgba", "transform_matrix": [list(row) for row in matrix]})
        transforms = {"camera_angle_x": elsewhere.FIELD_OF_VIEW, "frames": frames}
        (out / f"transforms_{kind}.json").write_text(json.dumps(transforms))
    show_albedo()
    bpy.context.scene.cycles.samples = ALBEDO_SAMPLES
    for k, matrix in enumerate(views["test"]):
        elsewhere.photograph(matrix, out / f"test_{k:03d}" / "albedo.png")
    facts = {"albedo_png": "sRGB-encoded base color", "train_env": name, "relight": others}
    (out / "scene.json").write_text(json.dumps(facts))


def main():
    scenes = {"monkey": elsewhere.monkey, "blocks": elsewhere.blocks, "cloth": elsewhere.cloth}
    is_size = len(sys.argv) == 4 or (len(sys.argv) == 5 and sys.argv[4].isdecimal() and int(sys.argv[4]) > 0)
    if not is_size or sys.argv[1] not in scenes or sys.argv[2] not in LEVELS:
        sys.exit(__doc__)
    side = int(sys.argv[4]) if len(sys.argv) == 5 else SIDE
    out = Path(sys.argv[3]).resolve()
    (out / "envmaps").mkdir(parents=True)
    bpy.ops.wm.read_factory_settings(use_empty=True)
    for name in LEVELS:
        write(light(name), out / "envmaps" / f"{name}.hdr")
    scenes[sys.argv[1]]()
    elsewhere.fit()
    elsewhere.prepare(str(out / "envmaps" / f"{sys.argv[2]}.hdr"))
    scene = bpy.context.scene
    scene.render.resolution_x = scene.render.resolution_y = side
    render(out, sys.argv[2], [name for name in LEVELS if name != sys.argv[2]])


if __name__ == "__main__":
    main()
