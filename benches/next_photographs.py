"""Compares ten further photographs that `relume capture next` chooses with ten random ones.

Usage: python3 next_photographs.py RELUME WORK SCENE...

RELUME is the program, and every SCENE a capture in the layout of TensoIR-Synthetic. The first training has 12 photographs from a third of the circle
around the object. Ten of the other photographs are added: those that `relume capture next` chooses, and ten random ones for each of two seeds. Prints
PSNR over the held-out views: of the photographs' light, and of the relit pictures with aligned albedo. Trainings are drafts of 128 px. WORK gets captures and models; finished
trainings are not repeated.
"""

import json
import math
import os
import random
import subprocess
import sys
from pathlib import Path

FIRST, ADDED, SEEDS = 12, 10, (0, 1)
TRAINING = ["--preset", "draft", "--resolution", "128", "--set", "max_gaussians=8000", "--seed", "0"]


def azimuth(frame):
    x, y = (frame["transform_matrix"][row][3] for row in (0, 1))
    return math.atan2(y, x)


def capture(scene, folder, frames):
    """A capture of some photographs of a scene: links to its files."""
    folder.mkdir(parents=True, exist_ok=True)
    for file in scene.iterdir():
        link = folder / file.name
        if file.name != "transforms_train.json" and not link.exists():
            link.symlink_to(file.resolve(), target_is_directory=file.is_dir())
    maps, link = scene.resolve().parent.parent / "envmaps", folder.parent.parent / "envmaps"
    if maps.is_dir() and not link.exists():
        link.symlink_to(maps, target_is_directory=True)
    whole = json.loads((scene / "transforms_train.json").read_text())
    (folder / "transforms_train.json").write_text(json.dumps(whole | {"frames": frames}))


def scores(relume, folder):
    """PSNR of novel views and of aligned relit pictures of the model in a folder, which is trained first."""
    model, report = folder / "model.safetensors", folder / "report.json"
    if not model.exists():
        train = [relume, "train", folder / "capture", *TRAINING, "--out", model]
        subprocess.run(train, check=True, capture_output=True)
    if not report.exists():
        evaluate = [relume, "eval", model, "--capture", folder / "capture", "--resolution", "128", "--json", report]
        subprocess.run(evaluate, check=True, capture_output=True)
    found = json.loads(report.read_text())
    return found["novel_view"]["psnr"], found["relit_aligned"]["mean"]["psnr"]


def chosen(relume, folder, pool, camera_angle):
    """The frames of the pool that `relume capture next` chooses."""
    among = folder / "pool.json"
    among.write_text(json.dumps({"camera_angle_x": camera_angle, "frames": pool}))
    command = [relume, "capture", "next", folder / "model.safetensors", "--count", str(ADDED), "--among", among]
    lines = subprocess.run(command, check=True, capture_output=True, text=True).stdout.splitlines()[1:]
    return [pool[int(line.split()[1])] for line in lines]


def main(relume, work, *scenes):
    print("| scene | photographs | novel views, dB | relit, dB |\n|---|---|---:|---:|")
    for scene in map(Path, scenes):
        whole = json.loads((scene / "transforms_train.json").read_text())
        frames = sorted(whole["frames"], key=azimuth)
        third = frames[: len(frames) // 3]
        first = [third[i * len(third) // FIRST] for i in range(FIRST)]
        pool = [frame for frame in frames if frame not in first]
        folders = Path(work) / scene.name
        sets = {"first": []}
        capture(scene, folders / "first" / "capture", first)
        rows = [(f"{FIRST} of a third of the circle", scores(relume, folders / "first"))]
        sets["next"] = chosen(relume, folders / "first", pool, whole["camera_angle_x"])
        for seed in SEEDS:
            sets[f"random{seed}"] = random.Random(seed).sample(pool, ADDED)
        for name, added in list(sets.items())[1:]:
            capture(scene, folders / name / "capture", first + added)
            rows.append((f"{ADDED} more, {name}", scores(relume, folders / name)))
        for name, (novel, relit) in rows:
            print(f"| {scene.name} | {name} | {novel:.2f} | {relit:.2f} |", flush=True)


if __name__ == "__main__":
    os.environ.setdefault("XDG_RUNTIME_DIR", "/tmp")
    main(*sys.argv[1:])
