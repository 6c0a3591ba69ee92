"""compare.py DATA MODELS OUT RELUME FOLDER [PART...]: measures exported files in other programs, and prints Markdown tables.

The programs are Blender (Cycles), three.js, Babylon.js and PlayCanvas.

DATA has scenes/NAME/transforms_test.json with path-traced test_XXX/rgba_LIGHT.png, and envmaps/LIGHT.hdr.
MODELS has helmet.safetensors and drape.safetensors, as this command writes them (NAME is helmet or drape):
`relume train DATA/scenes/NAME --preset draft --resolution 200 --set max_gaussians=16000 --seed 0 --out MODELS/NAME.safetensors`.
OUT receives all files. FOLDER is where `npm install three @babylonjs/core @babylonjs/loaders playcanvas playwright-core` ran.
Chromium is /usr/bin/chromium, or $CHROMIUM. Python needs bpy 5.0, NumPy and Pillow.
Each PART is one of `sphere`, `cycles`, `mesh`, `sun`, `splats`, `kept`; default: all. Pictures that exist are not drawn again.

Pictures are compared with frames of `relume render` in the tiers `standard` and `monte_carlo`, and with path-traced pictures (truth).
All figures are over the whole picture, over white, in display values (sRGB).
"""

import json
import math
import os
import pathlib
import subprocess
import sys

import numpy as np
import pictures

# Models, each with two lights under which the data has path-traced pictures; test views, from 1.
LIGHTS = {"helmet": ("bridge", "interior"), "drape": ("city", "noon")}
MODELS, VIEWS = tuple(LIGHTS), (4, 12)
# Side of the compared pictures; the browser draws pictures of meshes larger, and they are averaged.
SIDE, MESH_SIDE, SPLATS_SIDE = 200, 800, 200
# Azimuth and elevation of the small suns, degrees.
SUNS = {"sun-20": (20, 50), "sun-140": (140, 50), "sun-260": (260, 50)}
WEB = ("three", "babylon", "playcanvas")
NAMES = {"cycles": "Blender, Cycles", "three": "three.js", "babylon": "Babylon.js", "playcanvas": "PlayCanvas"}
HERE = pathlib.Path(__file__).resolve().parent
CHROMIUM = os.environ.get("CHROMIUM", "/usr/bin/chromium")


class Work:
    """The paths of a run and what they hold."""

    def __init__(self, data, models, out, relume, folder):
        self.data, self.models, self.out = (pathlib.Path(path).resolve() for path in (data, models, out))
        self.relume, self.folder = str(pathlib.Path(relume).resolve()), folder
        self.suns = {}
        for name, angles in SUNS.items():
            (self.out / "suns").mkdir(parents=True, exist_ok=True)
            self.suns[name] = pictures.write_sun(self.out / "suns" / f"{name}.hdr", *angles)

    def light(self, name):
        return self.out / "suns" / f"{name}.hdr" if name in SUNS else self.data / "envmaps" / f"{name}.hdr"

    def cameras(self, model):
        document = json.loads((self.data / "scenes" / (MODELS[0] if model == "sphere" else model) / "transforms_test.json").read_text())
        fov = math.degrees(document["camera_angle_x"])
        return [{"matrix": document["frames"][view - 1]["transform_matrix"], "fov": fov} for view in VIEWS]

    def drawn(self, model, program, kind, light):
        """The paths of the pictures of a program, one for each view."""
        folder = self.out / model / program
        folder.mkdir(parents=True, exist_ok=True)
        return [folder / f"{kind}-{light}-{view:03}.png" for view in VIEWS]

    def command(self, *words):
        subprocess.run([self.relume, *map(str, words)], check=True, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL)

    def own(self, model, light, tier="standard"):
        """Frames of Relume."""
        paths = self.drawn(model, f"own-{tier}", "frame", light)
        if not all(path.exists() for path in paths):
            cameras = self.data / "scenes" / model / "transforms_test.json"
            pattern = paths[0].parent / f"frame-{light}-%03d.png"
            self.command("render", self.models / f"{model}.safetensors", "--path", cameras, "--frames", ",".join(map(str, VIEWS)),
                         "--resolution", f"{SIDE}x{SIDE}", "--tier", tier, "--env", self.light(light), "--out", pattern)
        return paths

    def truth(self, model, light):
        return [self.data / "scenes" / model / f"test_{view - 1:03}" / f"rgba_{light}.png" for view in VIEWS]

    def exported(self, model, name, *options):
        file = self.out / model / name
        file.parent.mkdir(parents=True, exist_ok=True)
        if not file.exists():
            self.command("export", self.models / f"{model}.safetensors", "--out", file, *options)
        return file

    def job(self, model, program, kind, name, file, **more):
        """The pictures of a job under the light of this name, and a list that holds the job if they do not exist."""
        paths = self.drawn(model, program, f"{kind}{file.suffix}", name)
        done = all(path.exists() for path in paths)
        job = {"program": program, "kind": kind, "file": str(file), "cameras": self.cameras(model), "pictures": [str(path) for path in paths]}
        return paths, ([] if done else [{**job, **more}])

    def run(self, jobs, program):
        """Runs the jobs of Blender or of the browser."""
        if not jobs:
            return
        list_of_jobs = self.out / "jobs.json"
        list_of_jobs.write_text(json.dumps(jobs))
        if program == "cycles":
            subprocess.run([sys.executable, HERE / "blender.py", list_of_jobs], check=True, stdout=subprocess.DEVNULL)
        else:
            subprocess.run(["node", HERE / "web.mjs", list_of_jobs, CHROMIUM, self.folder], check=True)


def average(paths, references):
    """Mean PSNR of several pictures, and the mean of their colour ratios."""
    found = [pictures.compare(a, b, SIDE) for a, b in zip(paths, references, strict=True)]
    return np.mean([score for score, _ in found]), np.mean([ratio for _, ratio in found], axis=0)


def row(work, model, light, name, paths):
    """A row of a table: the program against frames of both tiers, and against path-traced pictures if the data has them."""
    if not all(path.exists() for path in paths):
        return f"| {name} | {model} | {light} | not drawn | | | | |"
    cells = []
    for references in (work.own(model, light), work.own(model, light, "monte_carlo")):
        if paths == references:
            cells += ["-", "-"]
            continue
        score, ratio = average(paths, references)
        cells += [f"{score:.1f}", " ".join(f"{value:.2f}" for value in ratio)]
    truth = work.truth(model, light)
    against = f"{average(paths, truth)[0]:.1f}" if all(path.exists() for path in truth) else "-"
    return f"| {' | '.join([name, model, light, *cells, against])} |"


def heading(title):
    print(f"\n{title}\n\n| program | model | light | PSNR to `standard`, dB | colour R G B | PSNR to `monte_carlo`, dB | colour R G B | PSNR to truth, dB |")
    print("|---|---|---|---:|---|---:|---|---:|")


def pictures_of_meshes(work, programs):
    drawn, jobs = [], []
    for model in MODELS:
        mesh = work.exported(model, "mesh.glb", "--mesh")
        for light in LIGHTS[model]:
            for program in programs:
                side = SIDE if program == "cycles" else MESH_SIDE
                paths, more = work.job(model, program, "mesh", light, mesh, light=str(work.light(light)), side=side)
                drawn.append((program, model, light, paths))
                jobs += more
    work.run(jobs, programs[0])
    heading("Mesh under a map")
    if programs[0] == "cycles":
        for model in MODELS:
            for light in LIGHTS[model]:
                for tier in ("standard", "monte_carlo"):
                    print(row(work, model, light, f"Relume, `{tier}`", work.own(model, light, tier)))
    for program, model, light, paths in drawn:
        print(row(work, model, light, NAMES[program], paths))


def pictures_of_spheres(work):
    """How much the programs differ for a grey sphere, which is not a file of Relume."""
    sphere = work.out / "sphere" / "sphere.glb"
    if not sphere.exists():
        sphere.parent.mkdir(exist_ok=True)
        work.run([{"kind": "sphere", "file": str(sphere)}], "cycles")
    print("\nControl: a grey sphere of roughness 0.5\n\n| program | light | PSNR to Cycles, dB | colour ratio R G B |\n|---|---|---:|---|")
    for light in (*LIGHTS[MODELS[0]], next(iter(SUNS))):
        truth = []
        for program in ("cycles", *WEB):
            more = {"light": str(work.light(light)), "side": SIDE}
            if program != "cycles":
                more = {**({"sun": work.suns[light]} if light in SUNS else more), "side": MESH_SIDE}
            paths, jobs = work.job("sphere", program, "mesh", light, sphere, **more)
            work.run(jobs, program)
            truth = truth or paths
            if program != "cycles":
                score, ratio = average(paths, truth)
                print(f"| {NAMES[program]} | {light} | {score:.1f} | {' '.join(f'{value:.2f}' for value in ratio)} |")


def pictures_of_suns(work):
    drawn = []
    for program in ("cycles", *WEB):
        jobs = []
        for model in MODELS:
            mesh = work.exported(model, "mesh.glb", "--mesh")
            for name, direction in work.suns.items():
                more = {"light": str(work.light(name)), "side": SIDE} if program == "cycles" else {"sun": direction, "side": 2 * SIDE}
                paths, new = work.job(model, program, "mesh", name, mesh, **more)
                drawn.append((program, model, name, paths))
                jobs += new
        work.run(jobs, program)
    heading("Mesh under a sun from three directions")
    for program, model, light, paths in drawn:
        print(row(work, model, light, NAMES[program], paths))
    print("\nControl: pictures under one sun against own frames under the next, PSNR in dB\n\n| program | model | PSNR |\n|---|---|---:|")
    following = dict(zip(SUNS, [*list(SUNS)[1:], next(iter(SUNS))], strict=True))
    for program in ("cycles", *WEB):
        for model in MODELS:
            scores = [average(paths, work.own(model, following[light]))[0] for p, m, light, paths in drawn if (p, m) == (program, model) and paths[0].exists()]
            print(f"| {NAMES[program]} | {model} | {np.mean(scores):.1f} |")


def pictures_of_splats(work):
    drawn, jobs = [], []
    for model in MODELS:
        for light in LIGHTS[model]:
            for kind, programs in ((".glb", WEB), (".ply", ("playcanvas",))):
                file = work.exported(model, f"relit-{light}{kind}", "--env", work.light(light))
                for program in programs:
                    paths, more = work.job(model, program, "splats", light, file, side=SPLATS_SIDE)
                    drawn.append((f"{NAMES[program]}, {kind}", model, light, paths))
                    jobs += more
    work.run(jobs, WEB[0])
    heading("Gaussians with the light in their colours")
    for name, model, light, paths in drawn:
        print(row(work, model, light, name, paths))


def attributes(work):
    """What each program keeps of the files with materials."""
    files = [(work.exported(MODELS[0], f"materials{kind}"), kind) for kind in (".ply", ".glb", ".usdz")]
    wanted = {"cycles": (".ply", ".glb", ".usdz"), "three": (".ply", ".glb"), "babylon": (".ply", ".glb"), "playcanvas": (".ply", ".glb")}
    print("\n| program | file | object | elements | attributes |\n|---|---|---|---:|---|")
    for program, kinds in wanted.items():
        jobs = []
        for file, kind in files:
            if kind in kinds:
                jobs.append({"program": program, "kind": "kept", "file": str(file), "answer": str(work.out / f"kept-{program}{kind}.json")})
        work.run(jobs, program)
        for job in jobs:
            found = json.loads(pathlib.Path(job["answer"]).read_text())
            names = [name for name in found["attributes"] if not name.startswith(("f_rest_", "KHR_gaussian_splatting:SH"))]
            print(f"| {NAMES[program]} | {pathlib.Path(job['file']).suffix} | {found['type']} | {found['count']} | {' '.join(names)} |")


def main():
    work = Work(*sys.argv[1:6])
    parts = sys.argv[6:] or ["sphere", "cycles", "mesh", "sun", "splats", "kept"]
    if "sphere" in parts:
        pictures_of_spheres(work)
    if "cycles" in parts:
        pictures_of_meshes(work, ("cycles",))
    if "mesh" in parts:
        pictures_of_meshes(work, WEB)
    if "sun" in parts:
        pictures_of_suns(work)
    if "splats" in parts:
        pictures_of_splats(work)
    if "kept" in parts:
        attributes(work)


if __name__ == "__main__":
    main()
