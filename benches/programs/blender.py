"""blender.py JOBS: renders exported meshes in Cycles, and lists the attributes that Blender keeps (Python module bpy, 5.0).

JOBS is the JSON file that compare.py writes: a list of jobs. A job of the kind `mesh` has `file` (.glb), `light` (.hdr), `cameras` (`matrix`, camera to world,
+Z up, and `fov`, vertical degrees), `side` (pixels) and `pictures`, a path for each camera. A job of the kind `kept` has `file` (.glb, .ply, .usda or .usdz) and
`answer`, the path of a JSON file. A job of the kind `sphere` writes a grey sphere as `file`.
"""

import json
import math
import pathlib
import sys

import bpy
from mathutils import Matrix

SAMPLES = 64


def load(file):
    """An empty scene with the objects of a file."""
    bpy.ops.wm.read_factory_settings(use_empty=True)
    kind = pathlib.Path(file).suffix
    if kind == ".glb":
        bpy.ops.import_scene.gltf(filepath=file)
    elif kind == ".ply":
        bpy.ops.wm.ply_import(filepath=file, import_attributes=True)
    else:
        bpy.ops.wm.usd_import(filepath=file, import_all_materials=True)


def set_light(file):
    """The map as the world. Blender's environment texture has the directions of Relume, so it needs no rotation."""
    world = bpy.context.scene.world = bpy.data.worlds.new("light")
    nodes, links = world.node_tree.nodes, world.node_tree.links
    texture = nodes.new("ShaderNodeTexEnvironment")
    texture.image = bpy.data.images.load(file)
    background = next(node for node in nodes if node.type == "BACKGROUND")
    links.new(texture.outputs["Color"], background.inputs["Color"])
    world.cycles.sampling_method = "MANUAL"
    world.cycles.sample_map_resolution = 1024


def set_renderer(side):
    scene = bpy.context.scene
    scene.render.engine = "CYCLES"
    scene.cycles.device = "CPU"
    scene.cycles.samples = SAMPLES
    scene.cycles.use_adaptive_sampling = False
    scene.cycles.use_denoising = False
    scene.cycles.seed = 0
    scene.cycles.pixel_filter_type = "BOX"
    scene.cycles.filter_width = 1.0
    scene.render.film_transparent = True
    scene.render.resolution_x = scene.render.resolution_y = side
    scene.render.resolution_percentage = 100
    scene.render.dither_intensity = 0
    scene.render.image_settings.file_format = "PNG"
    scene.render.image_settings.color_mode = "RGBA"
    scene.view_settings.view_transform = "Standard"


def draw(job):
    load(job["file"])
    set_light(job["light"])
    set_renderer(job["side"])
    scene = bpy.context.scene
    scene.camera = bpy.data.objects.new("camera", bpy.data.cameras.new("camera"))
    scene.collection.objects.link(scene.camera)
    scene.camera.data.sensor_fit = "VERTICAL"
    for camera, picture in zip(job["cameras"], job["pictures"], strict=True):
        scene.camera.matrix_world = Matrix(camera["matrix"])
        scene.camera.data.angle = math.radians(camera["fov"])
        scene.render.filepath = picture
        bpy.ops.render.render(write_still=True)


def write_sphere(file):
    """A grey sphere of roughness 0.5 as .glb, to compare the lights of programs."""
    bpy.ops.wm.read_factory_settings(use_empty=True)
    bpy.ops.mesh.primitive_uv_sphere_add(segments=64, ring_count=32, radius=0.9)
    bpy.ops.object.shade_smooth()
    material = bpy.data.materials.new("grey")
    surface = next(node for node in material.node_tree.nodes if node.type == "BSDF_PRINCIPLED")
    surface.inputs["Base Color"].default_value = (0.8, 0.8, 0.8, 1)
    surface.inputs["Roughness"].default_value = 0.5
    bpy.context.object.data.materials.append(material)
    bpy.ops.export_scene.gltf(filepath=file)


def kept(file):
    """The attributes of the first object with data."""
    try:
        load(file)
    except RuntimeError as error:
        return {"type": f"not read: {str(error).strip().splitlines()[-1]}", "count": 0, "attributes": []}
    for item in bpy.data.objects:
        if hasattr(item.data, "attributes"):
            count = len(getattr(item.data, "vertices", getattr(item.data, "points", [])))
            names = sorted(attribute.name for attribute in item.data.attributes if not attribute.name.startswith("."))
            return {"type": item.type, "count": count, "attributes": names}
    return {"type": "nothing", "count": 0, "attributes": []}


def main():
    for job in json.loads(pathlib.Path(sys.argv[1]).read_text()):
        if job["kind"] == "kept":
            pathlib.Path(job["answer"]).write_text(json.dumps(kept(job["file"])))
        elif job["kind"] == "sphere":
            write_sphere(job["file"])
        else:
            draw(job)


if __name__ == "__main__":
    main()
