"""Makes a capture under two lights from two captures of the same views.

Usage: python3 light_groups.py FIRST SECOND OUT

FIRST and SECOND are captures of lights.py with the same scene. OUT gets the even photographs of FIRST and the odd ones of SECOND, each with the name of its
light as light group, so that it has as many photographs as either; and the held-out views of FIRST. OUT must not exist.
"""

import json
import shutil
import sys
from pathlib import Path


def frames(folder, split):
    return json.loads((folder / f"transforms_{split}.json").read_text())


def main(first, second, out):
    sources = [Path(first), Path(second)]
    lights = [source.name.rsplit("-", 1)[-1] for source in sources]
    out = Path(out)
    out.mkdir(parents=True)
    sets = [frames(source, "train") for source in sources]
    if [f["transform_matrix"] for f in sets[0]["frames"]] != [f["transform_matrix"] for f in sets[1]["frames"]]:
        sys.exit("the captures have different views")
    chosen = []
    for i, pair in enumerate(zip(*(s["frames"] for s in sets))):
        frame, source = pair[i % 2], sources[i % 2]
        folder = Path(frame["file_path"]).parent
        shutil.copytree(source / folder, out / folder)
        chosen.append({**frame, "light_group": lights[i % 2]})
    (out / "transforms_train.json").write_text(json.dumps({**sets[0], "frames": chosen}))
    held_out = frames(sources[0], "test")
    held_out["frames"] = [{**frame, "light_group": lights[0]} for frame in held_out["frames"]]
    (out / "transforms_test.json").write_text(json.dumps(held_out))
    for folder in [*sources[0].glob("test_*"), sources[0] / "envmaps"]:
        shutil.copytree(folder, out / folder.name)
    shutil.copy(sources[0] / "scene.json", out)


if __name__ == "__main__":
    main(*sys.argv[1:])
