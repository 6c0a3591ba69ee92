"""Path-traces a furnished room as a phone photographs it, with Cycles (bpy 5.0), in the layout of nerfstudio.

Usage: python3 room.py OUTSIDE OTHER OUT

A table with a few things on it stands in a room with a window and a lamp. OUTSIDE is the environment map (.hdr or .exr) behind the window in
the 60 photographs. OUT/room gets them with points, as structure from motion finds them, and six held-out views (`held_out.json`), each with
masks of what stands out (`mask.png`: table and things, `table.png`: the table), the albedo, the view without the things (`without.png`) and the
view with the lamp off and the map OTHER behind the window (`rgba_other.png`). OUT/outside.hdr and OUT/other.hdr are the light of the two
rooms at the table, without table and things. OUT must not exist. It takes about 25 minutes on two cores.
"""

import json
import math
import random
import sys
from pathlib import Path

import bpy
import numpy
from elsewhere import add, material
from mathutils import Matrix, Vector

WIDTH, HEIGHT = 240, 320
SAMPLES = 48
FIELD_OF_VIEW = math.radians(50)
TABLE_TOP = 0.75
SUBJECT = Vector((0.1, -0.1, TABLE_TOP + 0.12))
MEDIAN_OF_PHOTOGRAPHS = 0.18
POINTS_OF_A_PHOTOGRAPH = 80
POINT_ERROR = 0.003


def box(of, low, high):
    """Adds a box with two opposite corners."""
    middle = [(a + b) / 2 for a, b in zip(low, high)]
    return add("cube", of, False, size=1, location=middle, scale=[b - a for a, b in zip(low, high)])


def shell():
    """Floor, ceiling and walls of 4.4 x 3.8 x 2.6 m; the wall at x = -2.2 has a window of 1.6 x 1.2 m."""
    wall, thick = material((0.72, 0.69, 0.63), 0.9), 0.15
    west, east, south, north, top = -2.2, 2.2, -1.9, 1.9, 2.6
    box(material((0.33, 0.20, 0.11), 0.5), (west, south, -thick), (east, north, 0))
    box(material((0.80, 0.80, 0.78), 0.9), (west, south, top), (east, north, top + thick))
    box(wall, (east, south, 0), (east + thick, north, top))
    box(material((0.40, 0.47, 0.42), 0.9), (west, north, 0), (east, north + thick, top))
    box(wall, (west, south - thick, 0), (east, south, top))
    left, right, sill, lintel = -0.9, 0.7, 0.9, 2.1
    box(wall, (west - thick, south, 0), (west, north, sill))
    box(wall, (west - thick, south, lintel), (west, north, top))
    box(wall, (west - thick, south, sill), (west, left, lintel))
    box(wall, (west - thick, right, sill), (west, north, lintel))
    frame = material((0.85, 0.85, 0.83), 0.4)
    box(frame, (west - 0.08, -0.13, sill), (west - 0.04, -0.08, lintel))


def furniture():
    """What stands along the walls. Returns the lamp's emission node."""
    wood, cloth = material((0.45, 0.28, 0.14), 0.4), material((0.12, 0.18, 0.32), 0.95)
    box(wood, (0.9, 1.5, 0), (2.0, 1.85, 1.8))
    draw = random.Random(5)
    for shelf in range(3):
        for k in range(12):
            colour = [draw.uniform(0.05, 0.7) for _ in range(3)]
            x, z = 0.95 + 0.085 * k, 0.3 + 0.5 * shelf
            box(material(colour, 0.7), (x, 1.42, z), (x + 0.07, 1.51, z + draw.uniform(0.2, 0.32)))
    box(cloth, (1.3, -1.5, 0.0), (2.1, 0.4, 0.42))
    box(cloth, (1.85, -1.5, 0.42), (2.1, 0.4, 0.85))
    for k, colour in enumerate([(0.6, 0.15, 0.1), (0.1, 0.4, 0.45), (0.75, 0.6, 0.25)]):
        box(material(colour, 0.8), (-1.5 + 1.1 * k, -1.89, 1.2), (-0.8 + 1.1 * k, -1.87, 1.9))
    stand = material((0.1, 0.1, 0.1), 0.4)
    add("cylinder", stand, radius=0.015, depth=1.4, location=(1.7, -1.65, 0.7))
    glow = material((0, 0, 0), 1)
    add("uv_sphere", glow, radius=0.14, location=(1.7, -1.65, 1.5))
    emission = glow.node_tree.nodes["Principled BSDF"]
    emission.inputs["Emission Color"].default_value = (1.0, 0.72, 0.42, 1)
    return emission


def subject():
    """Table and things on it. Returns the objects of the table and the things."""
    table = [add("cylinder", material((0.62, 0.56, 0.48), 0.6), False, vertices=96, radius=0.55, depth=0.04, location=(0, 0, TABLE_TOP - 0.02))]
    table.append(add("cylinder", material((0.2, 0.2, 0.2), 0.5), radius=0.05, depth=TABLE_TOP - 0.04, location=(0, 0, TABLE_TOP / 2 - 0.02)))
    head = add("monkey", material((0.50, 0.24, 0.13), 0.5), size=0.30, location=(0.08, -0.08, TABLE_TOP + 0.14), rotation=(-0.5, 0, 0.6))
    head.modifiers.new("smooth", "SUBSURF").render_levels = 2
    things = [
        head,
        add("uv_sphere", material((0.75, 0.72, 0.68), 0.25), radius=0.07, location=(-0.18, 0.16, TABLE_TOP + 0.07)),
        add("cylinder", material((0.12, 0.30, 0.42), 0.6), radius=0.05, depth=0.2, location=(0.28, 0.2, TABLE_TOP + 0.1)),
        add("cube", material((0.65, 0.5, 0.1), 0.35), False, size=0.1, location=(-0.22, -0.22, TABLE_TOP + 0.05), rotation=(0, 0, 0.4)),
    ]
    return table, things


def camera_at(azimuth, elevation, distance, target):
    """Camera-to-world matrix that looks at `target`."""
    across = math.cos(elevation)
    away = distance * Vector((across * math.cos(azimuth), across * math.sin(azimuth), math.sin(elevation)))
    return Matrix.Translation(target + away) @ (-away).to_track_quat("-Z", "Y").to_matrix().to_4x4()


def cameras():
    """Matrices of the photographs, which go round the table in three heights, and of the held-out views."""
    draw = random.Random(1)

    def near(k, n):
        jitter = Vector([draw.uniform(-0.05, 0.05) for _ in range(3)])
        elevation = math.radians([14, 32, 52][k % 3] + draw.uniform(-5, 5))
        return camera_at(2 * math.pi * k / n + draw.uniform(-0.05, 0.05), elevation, draw.uniform(0.75, 1.15), SUBJECT + jitter)

    held_out = [camera_at(2 * math.pi * (k + 0.4) / 6, math.radians([22, 42][k % 2]), 0.95, SUBJECT) for k in range(6)]
    return [near(k, 60) for k in range(60)], held_out


class Studio:
    """The scene with its lights."""

    def __init__(self, outside, other):
        bpy.ops.wm.read_factory_settings(use_empty=True)
        shell()
        self.lamp = furniture()
        self.table, self.things = subject()
        scene = bpy.context.scene
        scene.render.engine = "CYCLES"
        scene.cycles.use_adaptive_sampling, scene.cycles.use_denoising, scene.cycles.max_bounces = False, True, 6
        scene.cycles.caustics_reflective = False
        scene.render.dither_intensity, scene.render.use_persistent_data = 0, False
        scene.view_settings.view_transform = "Standard"
        scene.world = bpy.data.worlds.new("world")
        scene.world.use_nodes = True
        nodes, links = scene.world.node_tree.nodes, scene.world.node_tree.links
        self.picture = nodes.new("ShaderNodeTexEnvironment")
        links.new(self.picture.outputs[0], nodes["Background"].inputs[0])
        self.background = nodes["Background"]
        self.maps = {name: bpy.data.images.load(str(Path(file).resolve())) for name, file in (("outside", outside), ("other", other))}
        bpy.ops.object.light_add(type="AREA", location=(-2.28, -0.1, 1.5), rotation=(0, -math.pi / 2, 0))
        portal = bpy.context.object.data
        portal.shape, portal.size, portal.size_y, portal.cycles.is_portal = "RECTANGLE", 1.2, 1.6, True
        self.portal = bpy.context.object
        lens = bpy.data.cameras.new("camera")
        lens.sensor_fit, lens.angle = "HORIZONTAL", FIELD_OF_VIEW
        scene.camera = bpy.data.objects.new("camera", lens)
        scene.collection.objects.link(scene.camera)
        self.exposure = 0.0

    def light(self, name, strength, lamp):
        """Puts a map behind the window and sets the lamp's strength."""
        self.picture.image = self.maps[name]
        self.background.inputs["Strength"].default_value = strength
        self.lamp.inputs["Emission Strength"].default_value = lamp

    def shot(self, matrix, file, samples=SAMPLES, size=(WIDTH, HEIGHT), is_hdr=False, exposure=None):
        """Renders one camera to a PNG or a Radiance file."""
        scene = bpy.context.scene
        scene.cycles.samples = samples
        scene.render.resolution_x, scene.render.resolution_y = size
        scene.camera.matrix_world = matrix
        settings = scene.render.image_settings
        settings.file_format = "HDR" if is_hdr else "PNG"
        scene.view_settings.exposure = self.exposure if exposure is None else exposure
        scene.render.filepath = str(file)
        bpy.ops.render.render(write_still=True)

    def expose(self, matrices, folder):
        """Sets the exposure by which the median of a few photographs is MEDIAN_OF_PHOTOGRAPHS in linear light."""
        values = []
        for matrix in matrices:
            file = folder / "exposure.hdr"
            self.shot(matrix, file, 32, (60, 80), True)
            picture = bpy.data.images.load(str(file), check_existing=False)
            values.append(numpy.median(numpy.array(picture.pixels[:]).reshape(-1, 4)[:, 1]))
            bpy.data.images.remove(picture)
            file.unlink()
        self.exposure = math.log2(MEDIAN_OF_PHOTOGRAPHS / numpy.mean(values))

    def hide(self, objects, is_hidden):
        for one in objects:
            one.hide_render = is_hidden

    def flat(self, colours, matrix, file):
        """Renders every object in one colour, without light."""
        outputs = []
        for one in (o for o in bpy.data.objects if o.type == "MESH"):
            tree = one.data.materials[0].node_tree
            glow = tree.nodes.new("ShaderNodeEmission")
            glow.inputs[0].default_value = (*colours(one), 1)
            output = tree.nodes["Material Output"].inputs[0]
            outputs.append((tree, output, output.links[0].from_socket, glow))
            tree.links.new(glow.outputs[0], output)
        bpy.context.scene.cycles.use_denoising, strength = False, self.background.inputs["Strength"].default_value
        self.background.inputs["Strength"].default_value = 0
        bounces, bpy.context.scene.cycles.max_bounces = bpy.context.scene.cycles.max_bounces, 0
        self.shot(matrix, file, 16, exposure=0.0)
        bpy.context.scene.cycles.max_bounces = bounces
        bpy.context.scene.cycles.use_denoising, self.background.inputs["Strength"].default_value = True, strength
        for tree, output, before, glow in outputs:
            tree.links.new(before, output)
            tree.nodes.remove(glow)

    def panorama(self, file):
        """Renders the light at the subject, without table and things, as an environment map."""
        lens = bpy.context.scene.camera.data
        self.hide(self.table + self.things, True)
        lens.type, lens.panorama_type = "PANO", "EQUIRECTANGULAR"
        turned = Matrix.Translation(SUBJECT) @ Matrix.Rotation(math.pi / 2, 4, "X")
        self.shot(Matrix(turned) @ Matrix.Rotation(-math.pi / 2, 4, "Y"), file, 256, (256, 128), True)
        lens.type = "PERSP"
        self.hide(self.table + self.things, False)


def pixels_of(file):
    """RGB of a PNG as stored, the first row on top."""
    picture = bpy.data.images.load(str(file), check_existing=False)
    picture.colorspace_settings.name = "Non-Color"
    values = numpy.array(picture.pixels[:]).reshape(picture.size[1], picture.size[0], 4)[::-1, :, :3]
    bpy.data.images.remove(picture)
    return values


def feature_points(photographs, folder):
    """Points on surfaces where the photographs have contrast, as structure from motion finds them: (position, colour)."""
    draw = numpy.random.default_rng(2)
    graph = bpy.context.evaluated_depsgraph_get()
    half = math.tan(FIELD_OF_VIEW / 2)
    points = []
    for k, matrix in enumerate(photographs):
        picture = pixels_of(folder / f"train_{k:03d}" / "rgba.png")
        across, down = numpy.gradient(picture.mean(-1))
        contrast = numpy.hypot(across, down).ravel()
        for i in draw.choice(contrast.size, POINTS_OF_A_PHOTOGRAPH, False, contrast / contrast.sum()):
            y, x = divmod(int(i), WIDTH)
            ray = Vector(((2 * x + 1) / WIDTH - 1, (HEIGHT - 2 * y - 1) / WIDTH, 0)) * half + Vector((0, 0, -1))
            direction = matrix.to_3x3() @ ray
            hit, place, *_ = bpy.context.scene.ray_cast(graph, matrix.translation, direction)
            if hit:
                points.append((place + Vector(draw.normal(0, POINT_ERROR, 3)), picture[y, x]))
    return points


def write_points(points, file):
    """Writes points as a PLY file."""
    properties = [*(f"property float {axis}" for axis in "xyz"), *(f"property uchar {name}" for name in ("red", "green", "blue"))]
    lines = ["ply", "format ascii 1.0", f"element vertex {len(points)}", *properties, "end_header"]
    for place, colour in points:
        lines.append(" ".join([*(f"{v:.5f}" for v in place), *(str(round(255 * v)) for v in colour)]))
    file.write_text("\n".join(lines) + "\n")


def base_colour(one):
    return one.data.materials[0].node_tree.nodes["Principled BSDF"].inputs["Base Color"].default_value[:3]


def scale_of(file, factor):
    """Multiplies a Radiance file: a view's exposure does not apply to files of linear light."""
    picture = bpy.data.images.load(str(file), check_existing=False)
    picture.pixels = [factor * v for v in picture.pixels[:]]
    picture.file_format = "HDR"
    picture.filepath_raw = str(file)
    picture.save()


LAMP = 8.0


def main(outside, other, out):
    out.mkdir(parents=True)
    room = out / "room"
    photographs, held_out = cameras()
    studio = Studio(outside, other)
    studio.light("outside", 1.0, LAMP)
    studio.expose(photographs[::15], out)
    frames = []
    for kind, matrices in (("train", photographs), ("test", held_out)):
        for k, matrix in enumerate(matrices):
            name = f"{kind}_{k:03d}"
            (room / name).mkdir(parents=True)
            studio.shot(matrix, room / name / "rgba.png")
            frames.append({"file_path": f"{name}/rgba.png", "transform_matrix": [list(row) for row in matrix]})
    write_points(feature_points(photographs, room), room / "points.ply")
    held_out_names = [frame["file_path"] for frame in frames[len(photographs) :]]
    lens = {"camera_angle_x": FIELD_OF_VIEW, "w": WIDTH, "h": HEIGHT, "ply_file_path": "points.ply"}
    for file, part, more in (("transforms.json", frames, {"test_filenames": held_out_names}), ("held_out.json", frames[len(photographs) :], {})):
        (room / file).write_text(json.dumps({**lens, **more, "frames": part}))
    table, shown = set(studio.table), set(studio.table + studio.things)
    for k, matrix in enumerate(held_out):
        folder = room / f"test_{k:03d}"
        studio.flat(base_colour, matrix, folder / "albedo.png")
        studio.flat(lambda one: (1.0,) * 3 if one in shown else (0.0,) * 3, matrix, folder / "mask.png")
        studio.flat(lambda one: (1.0,) * 3 if one in table else (0.0,) * 3, matrix, folder / "table.png")
        studio.hide(studio.things, True)
        studio.shot(matrix, folder / "without.png")
        studio.hide(studio.things, False)
    before = studio.exposure
    studio.panorama(out / "outside.hdr")
    scale_of(out / "outside.hdr", 2**before)
    studio.light("other", 1.0, 0.0)
    studio.expose(photographs[::15], out)
    factor = 2 ** (studio.exposure - before)
    studio.light("other", factor, 0.0)
    studio.exposure = before
    for k, matrix in enumerate(held_out):
        studio.shot(matrix, room / f"test_{k:03d}" / "rgba_other.png")
    studio.panorama(out / "other.hdr")
    scale_of(out / "other.hdr", 2**before)


if __name__ == "__main__":
    if len(sys.argv) != 4:
        sys.exit(__doc__)
    main(sys.argv[1], sys.argv[2], Path(sys.argv[3]).resolve())
