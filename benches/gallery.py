"""gallery.py DATA MODELS OUT RELUME: makes the pictures of docs/gallery.md from trained models (Pillow; on two cores about five minutes).

DATA has scenes/NAME with path-traced ground truth and envmaps/LIGHT.hdr. MODELS has NAME.safetensors for each scene, as
`relume train DATA/scenes/NAME --preset draft --resolution 200 --set max_gaussians=16000 --seed 0 --out MODELS/NAME.safetensors` writes it, and demo.safetensors, the model of `relume demo`.
OUT receives, for each scene, NAME-turntable.webp (the camera turns), NAME-light.webp (the light turns) and NAME-truth.webp (path-traced and relit pictures of one
test view under lights that the training did not see); materials.webp, the demonstration with changed materials; shadow-passes.webp and shadow.webp, the drape
on a floor under a sun; lamps.webp, models under lamps; and layers.webp, a photograph of the helmet without its light, and the confidence of the model.
"""

import pathlib
import subprocess
import sys
import tempfile

from PIL import Image, ImageChops, ImageDraw, ImageFont

# Scenes, each with the lights of its turntable and of its turning light.
SCENES = {"helmet": ("sunset", "studio"), "drape": ("overcast", "sunset")}
FRAMES, SIZE, MILLISECONDS = 36, 288, 83
# Number of the test view, from 1, and width and height of its pictures, pixels.
VIEW, VIEW_SIZE = 4, 256
QUALITY = 82
# Changes of materials of the demonstration, and the material whose mask is shown.
RECOLOUR, MASK = "2=#2244cc,2.roughness=0.1,3.metalness=1", 2
PAPER, INK, FLOOR = (244, 244, 244), (40, 40, 40), (196, 192, 184)


def render(relume, model, out, *options):
    subprocess.run([relume, "render", model, "--out", out, "--tier", "high", *map(str, options)], check=True, capture_output=True)


def animation(relume, model, file, *options):
    """An animated WebP of a sequence with a transparent background."""
    with tempfile.TemporaryDirectory() as folder:
        render(relume, model, f"{folder}/%03d.png", "--turntable", FRAMES, "--size", SIZE, *options)
        frames = [Image.open(path).convert("RGBA") for path in sorted(pathlib.Path(folder).glob("*.png"))]
    frames[0].save(file, save_all=True, append_images=frames[1:], duration=MILLISECONDS, loop=0, quality=QUALITY, method=6)


def on_paper(picture):
    paper = Image.new("RGBA", picture.size, (*PAPER, 255))
    return Image.alpha_composite(paper, picture.convert("RGBA")).convert("RGB").resize((VIEW_SIZE, VIEW_SIZE), Image.Resampling.LANCZOS)


def truth(relume, data, scene, model, file):
    """Rows of truth, relit picture and their difference times 4; a column per light."""
    views = sorted((data / "scenes" / scene).glob("test_*"))
    lights = sorted(path.stem.removeprefix("rgba_") for path in views[VIEW - 1].glob("rgba_*.png"))
    head, font = 22, ImageFont.load_default(13)
    sheet = Image.new("RGB", (VIEW_SIZE * len(lights), head + 3 * VIEW_SIZE), PAPER)
    draw = ImageDraw.Draw(sheet)
    for column, light in enumerate(lights):
        with tempfile.TemporaryDirectory() as folder:
            cameras = data / "scenes" / scene / "transforms_test.json"
            render(relume, model, f"{folder}/%03d.png", "--path", cameras, "--frames", VIEW, "--env", data / "envmaps" / f"{light}.hdr")
            relit = on_paper(Image.open(next(pathlib.Path(folder).glob("*.png"))))
        true = on_paper(Image.open(views[VIEW - 1] / f"rgba_{light}.png"))
        difference = ImageChops.difference(true, relit).point(lambda value: min(255, 4 * value))
        draw.text((column * VIEW_SIZE + 8, 4), light, INK, font)
        for row, (picture, name) in enumerate(((true, "path tracer"), (relit, "Relume"), (difference, "difference, times 4"))):
            sheet.paste(picture, (column * VIEW_SIZE, head + row * VIEW_SIZE))
            if column == 0:
                draw.text((8, head + row * VIEW_SIZE + 4), name, (220, 220, 220) if row == 2 else INK, font)
    sheet.save(file, quality=QUALITY + 6, method=6)


def materials(relume, model, file):
    """The demonstration, the same with changed materials, and the mask of a material."""
    with tempfile.TemporaryDirectory() as folder:
        common = ["--env", "sunset", "--size", VIEW_SIZE]
        render(relume, model, f"{folder}/0.png", *common)
        render(relume, model, f"{folder}/1.png", *common, "--recolour", RECOLOUR)
        subprocess.run([relume, "materials", model, "--masks", folder, "--size", str(VIEW_SIZE)], check=True, capture_output=True)
        pictures = [on_paper(Image.open(f"{folder}/{name}.png")) for name in ("0", "1", f"material_{MASK}")]
    sheet = Image.new("RGB", (VIEW_SIZE * len(pictures), VIEW_SIZE), PAPER)
    for column, picture in enumerate(pictures):
        sheet.paste(picture, (column * VIEW_SIZE, 0))
    sheet.save(file, quality=QUALITY + 6, method=6)


def on_floor(model, shadow):
    """The picture of a model over an even floor, which its shadow multiplies in display values."""
    floor = ImageChops.multiply(Image.new("RGB", model.size, FLOOR), shadow.convert("RGB"))
    return Image.alpha_composite(floor.convert("RGBA"), model.convert("RGBA")).convert("RGB")


def shadow_passes(relume, model, sun, out):
    """A model, its shadow pass, the parts of the pass by sun and sky, and the model over a floor; and a moving picture of the latter under a turning sun."""
    common = ["--env", sun, "--elevation", 30]
    with tempfile.TemporaryDirectory() as folder:
        turning = ["--turntable", FRAMES, "--camera-turn", 0, "--env-turn", 360]
        for output in ("rgb", "shadow"):
            render(relume, model, f"{folder}/{output}-%03d.png", *common, "--size", SIZE, "--output", output, *turning)
        outputs = ("rgb", "shadow", "shadow_key", "shadow_fill")
        for output in outputs:
            render(relume, model, f"{folder}/{output}.png", *common, "--size", VIEW_SIZE, "--output", output)
        alone, *passes = (Image.open(f"{folder}/{output}.png").convert("RGBA") for output in outputs)
        pictures = [on_paper(alone), *(picture.convert("RGB") for picture in passes), on_floor(alone, passes[0])]
        sheet = Image.new("RGB", (len(pictures) * VIEW_SIZE, VIEW_SIZE), PAPER)
        for column, picture in enumerate(pictures):
            sheet.paste(picture, (column * VIEW_SIZE, 0))
        sheet.save(out / "shadow-passes.webp", quality=QUALITY + 6, method=6)
        paths = [sorted(pathlib.Path(folder).glob(f"{output}-*.png")) for output in ("rgb", "shadow")]
        frames = [on_floor(Image.open(a), Image.open(b)) for a, b in zip(*paths, strict=True)]
    frames[0].save(out / "shadow.webp", save_all=True, append_images=frames[1:], duration=MILLISECONDS, loop=0, quality=QUALITY, method=6)


def lamps(relume, models, file):
    """The drape under two lamps alone and under a spot, and the helmet under two bulbs."""
    bulb = "point position=1,0.5,1 radius=0.08 intensity=4 kelvin=2700"
    box = "rectangle position=-1.5,-1,0.8 target=0,0,0 size=0.8,0.4 intensity=5 kelvin=7000"
    spot = "spot position=0.8,0.4,1.6 target=0.2,0.1,0.2 cone=25 radius=0.05 intensity=12 kelvin=3000"
    red, blue = "point position=1.2,-1,0.5 intensity=4 colour=#ff5020", "point position=-1,-1,0.8 intensity=4 colour=#2060ff"
    pictures = [
        ("drape", 40, ["--env", "white", "--exposure", -20, "--lamp", bulb, "--lamp", box]),
        ("drape", 40, ["--env", "night", "--lamp", spot]),
        ("helmet", 20, ["--env", "night", "--lamp", red, "--lamp", blue]),
    ]
    sheet = Image.new("RGB", (VIEW_SIZE * len(pictures), VIEW_SIZE), INK)
    with tempfile.TemporaryDirectory() as folder:
        for column, (model, azimuth, options) in enumerate(pictures):
            common = ["--azimuth", azimuth, "--elevation", 28, "--size", VIEW_SIZE]
            render(relume, models / f"{model}.safetensors", f"{folder}/o.png", *common, *options)
            picture = Image.open(f"{folder}/o.png").convert("RGBA")
            sheet.paste(picture, (column * VIEW_SIZE, 0), picture)
    sheet.save(file, quality=QUALITY + 6, method=6)


def layers(relume, data, model, file):
    """A photograph, its layers, and the confidence of the model from the same side."""
    scene, view = data / "scenes" / "helmet", "test_000"
    names = ["photograph", "albedo", "shading", "shadow", "specular", "confidence"]
    head, font = 22, ImageFont.load_default(13)
    sheet = Image.new("RGB", (VIEW_SIZE * len(names), head + VIEW_SIZE), PAPER)
    draw = ImageDraw.Draw(sheet)
    with tempfile.TemporaryDirectory() as folder:
        subprocess.run([relume, "delight", scene, model, "--name", view, "--format", "png", "--out", folder], check=True, capture_output=True)
        render(relume, model, f"{folder}/c%d.png", "--path", scene / "transforms_test.json", "--frames", 1, "--output", "confidence")
        for column, name in enumerate(names):
            path = {"photograph": scene / view / "rgba.png", "confidence": f"{folder}/c1.png"}.get(name)
            picture = Image.open(path or next(pathlib.Path(folder, name).glob("*.png")))
            sheet.paste(on_paper(picture), (column * VIEW_SIZE, head))
            draw.text((column * VIEW_SIZE + 8, 4), name, INK, font)
    sheet.save(file, quality=QUALITY + 6, method=6)


def main():
    data, models, out, relume = (pathlib.Path(argument).resolve() for argument in sys.argv[1:5])
    out.mkdir(parents=True, exist_ok=True)
    for scene, (turned, turning) in SCENES.items():
        model = models / f"{scene}.safetensors"
        animation(relume, model, out / f"{scene}-turntable.webp", "--env", turned)
        animation(relume, model, out / f"{scene}-light.webp", "--env", turning, "--camera-turn", 0, "--env-turn", 360)
        truth(relume, data, scene, model, out / f"{scene}-truth.webp")
    materials(relume, models / "demo.safetensors", out / "materials.webp")
    lamps(relume, models, out / "lamps.webp")
    layers(relume, data, models / "helmet.safetensors", out / "layers.webp")
    shadow_passes(relume, models / "drape.safetensors", data / "envmaps" / "noon.hdr", out)
    for path in sorted(out.glob("*.webp")):
        print(f"{path.name}: {path.stat().st_size // 1000} kB")


if __name__ == "__main__":
    main()
