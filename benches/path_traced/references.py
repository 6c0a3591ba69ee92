"""Path-traces what scores.py compares frames with, for a scene of elsewhere.py, with Cycles (bpy 5.0).

Usage: python3 references.py SCENE MAP MAP OUT [--side 200] [--kinds ground,lamps,materials]

SCENE is `monkey`, `blocks` or `cloth`, MAP an environment map (.hdr or .exr). OUT gets linear EXR files of three cameras among the photographs of the
captures of elsewhere.py and lights.py, whose positions are the same:

- ground/: a diffuse plane of albedo 0.5 under each map with the scene, and once without. The camera does not see the scene, but it casts its shadow
  and sends light to the plane. The plane lies at the lowest point of the scene (`lowest`); for a scene on a table also in place of the table (`table`).
- lamps/: the scene under one lamp of common.py, without a map.
- materials/: the scene under each map, as it is and with one material in another colour, and masks of what has this material.

OUT/cameras.json has the cameras for `relume render --path`, OUT/references.json the scene, the maps and the settings. OUT must not exist. It took
nine minutes for the monkey on two cores beside other work.
"""

import argparse
import json
import math
import sys
from pathlib import Path

import bpy

sys.path.insert(0, str(Path(__file__).resolve().parents[1]))
import common
import elsewhere
from mathutils import Vector

SAMPLES = {"ground": 96, "lamps": 192, "materials": 128}
MASK_SAMPLES = 16
PLANE_SIZE = 400
# Distance of the plane below the lowest point, so that no surface lies in it.
GAP = 1e-4
ALBEDO = 0.5


def things():
    """The objects of the scene."""
    return [one for one in bpy.data.objects if one.type == "MESH" and one.name != "ground"]


def heights(objects):
    """Least and greatest z of the surfaces as they are rendered."""
    bpy.context.view_layer.update()
    graph = bpy.context.evaluated_depsgraph_get()
    found = []
    for one in objects:
        evaluated = one.evaluated_get(graph)
        found += [(evaluated.matrix_world @ vertex.co).z for vertex in evaluated.to_mesh().vertices]
        evaluated.to_mesh_clear()
    return min(found), max(found)


def add_plane():
    """Adds the diffuse plane."""
    bpy.ops.mesh.primitive_plane_add(size=PLANE_SIZE)
    plane = bpy.context.object
    plane.name = "ground"
    of = bpy.data.materials.new("ground")
    of.use_nodes = True
    nodes = of.node_tree.nodes
    diffuse = nodes.new("ShaderNodeBsdfDiffuse")
    diffuse.inputs["Color"].default_value = (ALBEDO, ALBEDO, ALBEDO, 1)
    of.node_tree.links.new(diffuse.outputs[0], nodes["Material Output"].inputs[0])
    plane.data.materials.append(of)
    return plane


def add_lamp(lamp):
    """Adds a lamp of common.py and returns its object.

    `intensity` is the irradiance at distance 1. A point of power P has P / (4 pi), also in the cone of a spot; a flat lamp has P / pi along its axis.
    """
    kinds = {"point": "POINT", "spot": "SPOT", "rectangle": "AREA"}
    light = bpy.data.lights.new("lamp", kinds[lamp["shape"]])
    light.energy = (math.pi if lamp["shape"] == "rectangle" else 4 * math.pi) * lamp["intensity"]
    if lamp["shape"] == "rectangle":
        light.shape, (light.size, light.size_y) = "RECTANGLE", lamp["size"]
    else:
        light.shadow_soft_size, light.use_soft_falloff = lamp["radius"], False
    if lamp["shape"] == "spot":
        half = math.radians(lamp["cone"]) / 2
        inner, outer = math.cos(half * (1 - common.SOFT_EDGE)), math.cos(half)
        light.spot_size, light.spot_blend = 2 * half, (inner - outer) / (1 - outer)
    one = bpy.data.objects.new("lamp", light)
    one.location = lamp["position"]
    if "target" in lamp:
        towards = Vector(lamp["target"]) - Vector(lamp["position"])
        one.rotation_euler = towards.to_track_quat("-Z", "Y").to_euler()
    one.visible_camera = False
    bpy.context.scene.collection.objects.link(one)
    return one


class Studio:
    """The scene with its cameras and lights."""

    def __init__(self, scene, maps, side, out):
        bpy.ops.wm.read_factory_settings(use_empty=True)
        {"monkey": elsewhere.monkey, "blocks": elsewhere.blocks, "cloth": elsewhere.cloth}[scene]()
        elsewhere.fit()
        elsewhere.prepare(str(maps[0]))
        self.out, self.maps = out, {file.stem: bpy.data.images.load(str(file), check_existing=True) for file in maps}
        self.cameras = elsewhere.cameras()["between"][::2]
        render = bpy.context.scene.render
        render.resolution_x = render.resolution_y = side
        # Persistent data keep objects that were hidden since.
        render.use_persistent_data = False
        settings = render.image_settings
        settings.file_format, settings.color_depth, settings.color_mode = "OPEN_EXR", "32", "RGBA"
        nodes = bpy.context.scene.world.node_tree.nodes
        self.environment = next(node for node in nodes if node.type == "TEX_ENVIRONMENT")
        self.strength = nodes["Background"].inputs["Strength"]

    def under(self, light):
        """Takes a map as light; None: no light."""
        self.strength.default_value = 0.0 if light is None else 1.0
        if light is not None:
            self.environment.image = self.maps[light]

    def shoot(self, view, name):
        """Renders a camera to a file below the folder."""
        elsewhere.photograph(self.cameras[view], self.out / name)
        if not (self.out / name).exists():
            sys.exit(f"{name} was not written")

    def views(self):
        return range(len(self.cameras))


def ground(studio, places):
    """The plane at each place under each map, and without the scene; what stands below the plane is left out."""
    plane = add_plane()
    for one in things():
        one.visible_camera, one.hide_render = False, True
    for light in studio.maps:
        studio.under(light)
        studio.shoot(0, common.plane_file(light))
    for place, height in places.items():
        plane.location.z = height - GAP
        for one in things():
            one.hide_render = heights([one])[1] <= height + GAP
        for light in studio.maps:
            studio.under(light)
            for view in studio.views():
                studio.shoot(view, common.ground_file(place, light, view))
    bpy.data.objects.remove(plane)
    for one in things():
        one.visible_camera, one.hide_render = True, False


def lamps(studio, _):
    """The scene under each lamp alone."""
    studio.under(None)
    for name, lamp in common.LAMPS.items():
        one = add_lamp(lamp)
        for view in studio.views():
            studio.shoot(view, common.lamp_file(name, view))
        bpy.data.objects.remove(one)


def materials_of(colour):
    """The materials with a base colour."""
    def is_it(of):
        shader = of.node_tree.nodes.get("Principled BSDF") if of.node_tree else None
        return shader is not None and all(abs(a - b) < 1e-6 for a, b in zip(shader.inputs["Base Color"].default_value, colour))

    return [of for of in bpy.data.materials if is_it(of)]


def places():
    """Heights of the plane: the lowest point, and the upper side of a table."""
    found = {"lowest": heights(things())[0]}
    for of in materials_of(common.TABLE):
        found["table"] = heights([one for one in things() if of.name in one.data.materials])[1]
    return found


def materials(studio, of):
    """The scene with one material as it is and changed, and masks of what has this material."""
    colour = of.node_tree.nodes["Principled BSDF"].inputs["Base Color"]
    before = tuple(colour.default_value)
    for is_changed in (False, True):
        colour.default_value = (*common.linear(common.NEW_COLOUR), 1) if is_changed else before
        for light in studio.maps:
            studio.under(light)
            for view in studio.views():
                studio.shoot(view, common.material_file(light, view, is_changed))
    colour.default_value = before
    others = [one for one in things() if of.name not in one.data.materials]
    for one in others:
        one.is_holdout = True
    bpy.context.scene.cycles.samples, bpy.context.scene.cycles.use_denoising = MASK_SAMPLES, False
    for view in studio.views():
        studio.shoot(view, common.mask_file(view))
    bpy.context.scene.cycles.use_denoising = True
    for one in others:
        one.is_holdout = False


def write_cameras(cameras, side, file):
    """Writes the cameras for `relume render --path`. The pictures are square, so both fields of view are equal."""
    angle = math.degrees(elsewhere.FIELD_OF_VIEW)
    entries = [{"camera": {"camera_to_world": [list(row) for row in matrix], "axes": "opengl", "fov_y_deg": angle}} for matrix in cameras]
    file.write_text(json.dumps({"width": side, "height": side, "cameras": entries}, indent=1) + "\n")


def arguments():
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("scene", choices=common.CHANGED)
    parser.add_argument("maps", nargs=2, type=lambda text: Path(text).resolve())
    parser.add_argument("out", type=lambda text: Path(text).resolve())
    parser.add_argument("--side", type=int, default=200, help="width and height, pixels")
    parser.add_argument("--kinds", type=lambda text: text.split(","), default=list(common.KINDS))
    args = parser.parse_args()
    if not set(args.kinds) <= set(common.KINDS):
        parser.error(f"the kinds are {', '.join(common.KINDS)}")
    missing = [str(file) for file in args.maps if not file.is_file()]
    if missing or args.maps[0].stem == args.maps[1].stem:
        parser.error(f"not a file: {missing[0]}" if missing else "the maps must have different names")
    return args


def main():
    args = arguments()
    args.out.mkdir(parents=True)
    studio = Studio(args.scene, args.maps, args.side, args.out)
    changing = materials_of(common.CHANGED[args.scene])
    if len(changing) != 1:
        sys.exit(f"{len(changing)} materials have the base colour that changes")
    planes = places()
    write_cameras(studio.cameras, args.side, args.out / "cameras.json")
    steps = {"ground": (ground, planes), "lamps": (lamps, None), "materials": (materials, changing[0])}
    for kind in args.kinds:
        step, what = steps[kind]
        bpy.context.scene.cycles.samples = SAMPLES[kind]
        step(studio, what)
    facts = {"scene": args.scene, "maps": list(studio.maps), "views": len(studio.cameras), "side": args.side, "kinds": args.kinds}
    facts |= {"planes": planes, "samples": SAMPLES, "blender": bpy.app.version_string, "lamps": common.LAMPS}
    (args.out / "references.json").write_text(json.dumps(facts, indent=1) + "\n")


if __name__ == "__main__":
    main()
