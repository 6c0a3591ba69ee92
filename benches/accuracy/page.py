"""Writes a Markdown page from the JSON files of the tables.

Usage: python3 page.py FOLDER

FOLDER has the files table-NAME.json of measure.py. The page accuracy.md is written beside them.
"""

import json
import statistics
import sys
from pathlib import Path

from tables import TABLES

# Name, heading and digits of each column.
COLUMNS = [
    ("relit", "relit, raw", 2),
    ("relit_aligned", "relit, aligned", 2),
    ("novel_view", "novel view", 2),
    ("albedo_aligned", "albedo, aligned", 2),
    ("normals", "normals", 1),
    ("ao", "AO", 3),
    ("roughness", "roughness", 3),
]

HEAD = """# Accuracy

`python3 benches/accuracy/measure.py DATA LIGHTS WORK` measured these tables and wrote this page. Each table names its commit. Do not edit this page: change the tables in
benches/accuracy/tables.py, or the text in benches/accuracy/page.py.

Images are in dB PSNR, the mean over all held-out views. *Relit* pictures are under lights that the training did not see: *raw* as recovered, *aligned* after one factor for each channel of
the albedo. Normals are mean errors in degrees; AO and roughness are mean absolute errors, 0 to 1. [Results](../results.md) describes the protocol and the scenes.
The last captures are of benches/lights.py: their name is a scene and a light. Two settings were chosen with the help of monkey-lamps (decisions 0028 and 0053),
the others without these captures.
"""


def write_json(folder, table):
    """Writes one table into `folder`. Its rows have the figures of each seed."""
    (folder / f"table-{table['name']}.json").write_text(json.dumps(table, indent=1) + "\n")


def summary(values, digits):
    """Mean and, of several seeds, standard deviation; a dash if a seed has no value."""
    if any(v is None or v != v for v in values):
        return "-"
    mean = f"{statistics.fmean(values):.{digits}f}"
    return mean if len(values) == 1 else f"{mean} ± {statistics.stdev(values):.{digits}f}"


def means(rows, variant):
    """The row of means over all scenes of one variant."""
    scenes = [row["runs"] for row in rows if row["variant"] == variant]
    def mean(key, digits):
        values = [run[key] for runs in scenes for run in runs]
        usable = [statistics.fmean(run[key] for run in runs) for runs in scenes] if None not in values else []
        return f"**{statistics.fmean(usable):.{digits}f}**" if usable else "-"
    return [f"**mean of {len(scenes)}**", variant, *(mean(key, digits) for key, _, digits in COLUMNS)]


def section(table):
    """Markdown of one table."""
    rows = [
        [row["scene"], row["variant"], *(summary([run[key] for run in row["runs"]], digits) for key, _, digits in COLUMNS)]
        for row in table["rows"]
    ]
    variants = list(dict.fromkeys(row["variant"] for row in table["rows"]))
    rows += [means(table["rows"], variant) for variant in variants]
    seeds = sorted({run["seed"] for row in table["rows"] for run in row["runs"]})
    head = ["scene", "variant", *(heading for _, heading, _ in COLUMNS)]
    lines = [
        f"\n## {table['title']}\n",
        f"Preset `{table['preset']}`, {table['resolution']} px, seeds {', '.join(map(str, seeds))}; commit {table['commit']}, {table['machine']}. {table['about']}".strip() + "\n",
        "| " + " | ".join(head) + " |",
        "|---|---|" + "---:|" * len(COLUMNS),
        *("| " + " | ".join(row) + " |" for row in rows),
    ]
    return "\n".join(lines) + "\n"


def text(folder):
    """The page of the tables in `folder`."""
    files = [folder / f"table-{table['name']}.json" for table in TABLES]
    return HEAD + "".join(section(json.loads(file.read_text())) for file in files if file.exists())


def write_page(folder):
    """Writes the page of the tables in `folder`."""
    (folder / "accuracy").with_suffix(".md").write_text(text(folder))


if __name__ == "__main__":
    if len(sys.argv) != 2:
        sys.exit(__doc__)
    write_page(Path(sys.argv[1]))
