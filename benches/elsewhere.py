"""Path-traces small scenes whose held-out cameras stand elsewhere than the photographs, with Cycles (bpy 5.0) in the TensoIR layout.

Usage: python3 elsewhere.py SCENE MAP OUT

SCENE is `monkey`, `blocks` or `cloth`, MAP an environment map (.hdr or .exr). 60 photographs of 200 px are taken between 12 and 48 degrees
above the horizon. OUT gets one folder per group of held-out cameras, with the same photographs: `between` (six cameras among the photographs),
`above` and `below` (two cameras each, 30 degrees beyond the highest and the lowest photograph), `near` and `far` (half and twice the
distance). OUT must not exist.
"""

import json
import math
import os
import random
import sys
from pathlib import Path

import bpy
from mathutils import Matrix, Vector

SIDE = 200
SAMPLES = 48
FIELD_OF_VIEW = math.radians(40)
RADIUS = 1.2
DISTANCE = 0.88 * RADIUS / math.sin(FIELD_OF_VIEW / 2)
LOWEST, HIGHEST = math.radians(12), math.radians(48)
MIDDLE = (LOWEST + HIGHEST) / 2
BEYOND = math.radians(30)
GOLDEN_ANGLE = 2.399963


def material(colour, roughness, metallic=0.0):
    """A new Principled material."""
    new = bpy.data.materials.new("material")
    new.use_nodes = True
    inputs = new.node_tree.nodes["Principled BSDF"].inputs
    inputs["Base Color"].default_value = (*colour, 1)
    inputs["Roughness"].default_value = roughness
    inputs["Metallic"].default_value = metallic
    return new


def add(primitive, of, smooth=True, **shape):
    """Adds a mesh primitive of a material and returns the object."""
    getattr(bpy.ops.mesh, f"primitive_{primitive}_add")(**shape)
    new = bpy.context.object
    new.data.materials.append(of)
    if smooth:
        bpy.ops.object.shade_smooth()
    return new


def table(radius):
    """A slab whose upper side is the plane z = 0."""
    add("cylinder", material((0.55, 0.42, 0.30), 0.55), False, vertices=128, radius=radius, depth=0.1, location=(0, 0, -0.05))


def monkey():
    head = add("monkey", material((0.55, 0.25, 0.12), 0.45), size=1.4, location=(0, 0, 0.75))
    head.modifiers.new("smooth", "SUBSURF").render_levels = 2
    add("torus", material((0.8, 0.6, 0.2), 0.25, 1), location=(0.9, 0.5, 0.12), major_radius=0.3, minor_radius=0.1)
    add("cube", material((0.1, 0.35, 0.55), 0.6), False, size=0.5, location=(-0.8, 0.7, 0.25), rotation=(0, 0, 0.5))
    table(1.6)


def blocks():
    draw = random.Random(3)
    for k in range(14):
        colour = [draw.uniform(0.05, 0.8) for _ in range(3)]
        of = material(colour, draw.choice([0.2, 0.4, 0.7, 0.9]), 1.0 if k % 5 == 4 else 0.0)
        angle, away, height = GOLDEN_ANGLE * k, 0.25 * math.sqrt(k), draw.uniform(0.2, 0.6)
        x, y = away * math.cos(angle), away * math.sin(angle)
        if k % 3 == 0:
            add("cube", of, False, size=1, location=(x, y, height / 2), scale=(0.28, 0.28, height), rotation=(0, 0, angle))
        elif k % 3 == 1:
            add("cylinder", of, radius=0.14, depth=height, location=(x, y, height / 2))
        else:
            add("cone", of, radius1=0.2, depth=1.4 * height, location=(x, y, 0.7 * height))
    table(1.3)


def cloth():
    side = 160
    add("grid", material((0.30, 0.045, 0.035), 0.95), x_subdivisions=side, y_subdivisions=side, size=2)
    for vertex in bpy.context.object.data.vertices:
        x, y, _ = vertex.co
        away, angle = math.hypot(x, y), math.atan2(y, x)
        hanging = max(0.0, (away - 0.55) / 0.45)
        fold = 1 + 0.1 * math.sin(9 * angle + 1.3 * math.sin(2 * angle)) * min(hanging, 1.0)
        reach = (min(away, 0.55) + 0.38 * max(0.0, away - 0.55)) * fold / max(away, 1e-9)
        vertex.co = (x * reach, y * reach, -0.5 * hanging)
    for k, (colour, roughness, metallic) in enumerate(
        [((0.75, 0.72, 0.66), 0.08, 0), ((0.12, 0.3, 0.5), 0.3, 0), ((0.78, 0.57, 0.22), 0.25, 1), ((0.16, 0.4, 0.14), 0.95, 0)]
    ):
        angle = math.pi * k / 2
        place = (0.34 * math.cos(angle), 0.34 * math.sin(angle), 0.13)
        add("uv_sphere", material(colour, roughness, metallic), radius=0.13, location=place)


def fit():
    """Scales all objects into the ball of RADIUS around the origin."""
    bpy.context.view_layer.update()
    meshes = [o for o in bpy.data.objects if o.type == "MESH"]
    corners = [o.matrix_world @ Vector(corner) for o in meshes for corner in o.bound_box]
    low, high = (Vector(side(c[k] for c in corners) for k in range(3)) for side in (min, max))
    scale = RADIUS / ((high - low).length / 2)
    change = Matrix.Scale(scale, 4) @ Matrix.Translation(-(low + high) / 2)
    for one in meshes:
        one.matrix_world = change @ one.matrix_world


def camera_at(azimuth, elevation, distance=1.0):
    """Camera-to-world matrix that looks at the origin."""
    across = math.cos(elevation)
    place = distance * DISTANCE * Vector((across * math.cos(azimuth), across * math.sin(azimuth), math.sin(elevation)))
    return Matrix.Translation(place) @ (-place).to_track_quat("-Z", "Y").to_matrix().to_4x4()


def cameras():
    """Matrices by group; `photographs` are trained on."""
    draw = random.Random(0)
    low, high = math.sin(LOWEST), math.sin(HIGHEST)
    photographs = [
        camera_at(k * GOLDEN_ANGLE + 0.3 * draw.random(), math.asin(low + (high - low) * (k + draw.random()) / 60)) for k in range(60)
    ]
    turn = 2 * math.pi
    return {
        "photographs": photographs,
        "between": [camera_at(turn * (k + 0.37) / 6, MIDDLE) for k in range(6)],
        "above": [camera_at(turn * (k + 0.1) / 2, HIGHEST + BEYOND) for k in range(2)],
        "below": [camera_at(turn * (k + 0.2) / 2, LOWEST - BEYOND) for k in range(2)],
        "near": [camera_at(turn * (k + 0.3) / 2, MIDDLE, 0.5) for k in range(2)],
        "far": [camera_at(turn * (k + 0.4) / 2, MIDDLE, 2.0) for k in range(2)],
    }


def prepare(environment):
    """Sets renderer, light and camera."""
    scene = bpy.context.scene
    scene.render.engine = "CYCLES"
    scene.cycles.samples, scene.cycles.use_adaptive_sampling = SAMPLES, False
    scene.cycles.use_denoising, scene.cycles.max_bounces = True, 6
    scene.cycles.caustics_reflective = False
    scene.render.resolution_x = scene.render.resolution_y = SIDE
    scene.render.film_transparent, scene.render.dither_intensity = True, 0
    scene.render.use_persistent_data = True
    scene.view_settings.view_transform = "Standard"
    scene.render.image_settings.file_format = "PNG"
    scene.render.image_settings.color_mode = "RGBA"
    scene.world = bpy.data.worlds.new("world")
    scene.world.use_nodes = True
    nodes, links = scene.world.node_tree.nodes, scene.world.node_tree.links
    picture = nodes.new("ShaderNodeTexEnvironment")
    picture.image = bpy.data.images.load(environment)
    links.new(picture.outputs[0], nodes["Background"].inputs[0])
    lens = bpy.data.cameras.new("camera")
    lens.angle_x = FIELD_OF_VIEW
    scene.camera = bpy.data.objects.new("camera", lens)
    scene.collection.objects.link(scene.camera)


def photograph(matrix, file):
    """Renders one camera to a PNG with straight alpha."""
    bpy.context.scene.camera.matrix_world = matrix
    bpy.context.scene.render.filepath = str(file)
    bpy.ops.render.render(write_still=True)


def render(out):
    """Renders all cameras into `out`."""
    groups = cameras()
    frames = {}
    for group, matrices in groups.items():
        frames[group] = []
        for k, matrix in enumerate(matrices):
            kind = "train" if group == "photographs" else f"test_{group}"
            name = f"{kind}_{k:03d}"
            photograph(matrix, out / name / "rgba.png")
            frames[group].append({"file_path": f"./{name}/rgba", "transform_matrix": [list(row) for row in matrix]})
    for group in groups:
        if group == "photographs":
            continue
        folder = out / group
        folder.mkdir()
        for name, part in (("train", frames["photographs"]), ("test", frames[group])):
            transforms = {"camera_angle_x": FIELD_OF_VIEW, "frames": part}
            (folder / f"transforms_{name}.json").write_text(json.dumps(transforms))
            for frame in part:
                picture = frame["file_path"].split("/")[1]
                os.symlink(Path("..") / picture, folder / picture)


if __name__ == "__main__":
    if len(sys.argv) != 4 or sys.argv[1] not in ("monkey", "blocks", "cloth"):
        sys.exit(__doc__)
    target = Path(sys.argv[3])
    target.mkdir(parents=True)
    bpy.ops.wm.read_factory_settings(use_empty=True)
    {"monkey": monkey, "blocks": blocks, "cloth": cloth}[sys.argv[1]]()
    fit()
    prepare(str(Path(sys.argv[2]).resolve()))
    render(target.resolve())
