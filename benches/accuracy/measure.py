"""Trains and evaluates every row of the accuracy tables, and writes one JSON file a table and a Markdown page of all tables.

Usage: python3 measure.py DATA LIGHTS WORK [--tables NAME,NAME] [--seeds N,N] [--relume PROGRAM]

DATA has the folder `scenes` of CONTRIBUTING.md. LIGHTS has the captures of benches/lights.py, in folders named SCENE-LIGHT. WORK keeps a report for each
training, so an interrupted run continues where it stopped; use one WORK for each commit. The tables and the page are in WORK as well.
Only the standard library of Python is needed.
"""

import argparse
import json
import os
import platform
import subprocess
import sys
import time
from pathlib import Path

import page
from tables import GROUPS, KNOWN_LIGHTS, TABLES

REPOSITORY = Path(__file__).resolve().parents[2]


def processor():
    """Name of the processor and the number of cores that this process may use."""
    lines = Path("/proc/cpuinfo").read_text().splitlines() if Path("/proc/cpuinfo").exists() else []
    name = next((line.split(":")[1].strip() for line in lines if line.startswith("model name")), platform.processor())
    return f"{name}, {len(os.sched_getaffinity(0))} cores"


def run(program, *arguments):
    """Runs `relume`; on failure this program ends with its last messages."""
    done = subprocess.run([program, *map(str, arguments)], capture_output=True, text=True)
    if done.returncode:
        sys.exit(f"relume {' '.join(map(str, arguments))} failed:\n{done.stderr[-2000:]}")


def folder(scene, args):
    """Folder of the capture `scene`."""
    return Path(args.data) / "scenes" / scene if scene in GROUPS["scenes"] else Path(args.lights) / scene


def true_light(scene, args):
    """The map under which the photographs of `scene` were rendered."""
    if scene in KNOWN_LIGHTS:
        return Path(args.data) / "envmaps" / f"{KNOWN_LIGHTS[scene]}.hdr"
    return folder(scene, args) / "envmaps" / f"{scene.split('-')[1]}.hdr"


def figures(report):
    """The figures of one evaluation that the tables show; a missing figure is None."""
    return {
        "relit": report["relit"]["mean"]["psnr"],
        "relit_aligned": report["relit_aligned"]["mean"]["psnr"],
        "novel_view": report["novel_view"]["psnr"],
        "albedo_aligned": report["albedo"]["psnr_aligned"],
        "albedo_scale": report["albedo"]["scale"],
        "normals": report["normal_mae_deg"]["foreground"],
        "ao": report["ao_mae"],
        "roughness": report["roughness_mae"],
        "gaussians": report["gaussians"],
    }


def measure_row(table, scene, variant, seed, args):
    """Figures of one training, from its report in WORK if there is one."""
    name = f"{table['name']}-{scene}-{variant['name'].replace(' ', '-')}-{seed}"
    report = Path(args.work) / f"{name}.json"
    if not report.exists():
        model, started = Path(args.work) / f"{name}.relume", time.time()
        size = ("--resolution", table["resolution"], "--device", "cpu")
        light = ("--light", true_light(scene, args)) if variant.get("light") else ()
        run(args.relume, "train", folder(scene, args), "--preset", table["preset"], *size, "--seed", seed, *light, *variant["train"], "--out", model)
        run(args.relume, "eval", model, "--capture", folder(scene, args), *size, *variant.get("eval", ()), "--json", report)
        print(f"{name}: {time.time() - started:.0f} s", flush=True)
        for written in Path(args.work).glob(f"{name}.relume*"):
            written.unlink()
    return {"seed": seed, **figures(json.loads(report.read_text()))}


def measure(table, args):
    """Measures one table and writes its JSON file."""
    rows = [
        {
            "scene": scene,
            "variant": variant["name"],
            "runs": [measure_row(table, scene, variant, seed, args) for seed in variant["seeds"] if seed in args.seeds],
        }
        for scene in table["scenes"]
        for variant in table["variants"]
        if scene not in variant.get("without", ()) and set(variant["seeds"]) & set(args.seeds)
    ]
    head = {key: table[key] for key in ("name", "title", "about", "preset", "resolution")}
    commit = subprocess.run(["git", "-C", str(REPOSITORY), "rev-parse", "--short=8", "HEAD"], capture_output=True, text=True)
    head |= {"commit": commit.stdout.strip(), "machine": processor(), "rows": rows}
    page.write_json(Path(args.work), head)


def main():
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("data")
    parser.add_argument("lights")
    parser.add_argument("work")
    parser.add_argument("--tables", default=",".join(t["name"] for t in TABLES if t["default"]))
    parser.add_argument("--seeds", type=lambda text: [int(seed) for seed in text.split(",")], default=[0, 1, 2], help="only these of a table's seeds")
    parser.add_argument("--relume", default=str(REPOSITORY / "target/release/relume"))
    args = parser.parse_args()
    wanted = args.tables.split(",")
    unknown = set(wanted) - {t["name"] for t in TABLES}
    if unknown:
        parser.error(f"no table is named {', '.join(sorted(unknown))}")
    Path(args.work).mkdir(parents=True, exist_ok=True)
    for table in TABLES:
        if table["name"] in wanted:
            measure(table, args)
    page.write_page(Path(args.work))


main()
