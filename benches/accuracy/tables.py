"""The accuracy tables: which captures are trained, how, and with which seeds."""

GROUPS = {
    "scenes": ["helmet", "tableau", "chair", "yard", "lamp", "drape", "turntable"],
    "lights": ["blocks-softboxes", "blocks-sunset", "monkey-window", "monkey-lamps", "cloth-neon", "cloth-softboxes"],
}

# The map of the photographs of each scene; captures of benches/lights.py name theirs.
KNOWN_LIGHTS = {"helmet": "sunset", "tableau": "bridge", "chair": "forest", "yard": "noon", "lamp": "tungsten", "drape": "dawn"}

# The light of the turntable's photographs rotates, so no single map describes it.
KNOWN = {"name": "light known", "seeds": [0], "train": [], "light": True, "without": ["turntable"]}


def published(method):
    """A published method, trained from one seed."""
    return {"name": method, "seeds": [0], "train": ["--method", method]}


# `default` tables are measured unless `--tables` says otherwise; the others take hours on a CPU.
TABLES = [
    {
        "name": "light",
        "title": "The light unknown and known",
        "about": "With several seeds: the mean and, after ±, the standard deviation of the seeds.",
        "default": True,
        "preset": "draft",
        "resolution": 128,
        "scenes": GROUPS["scenes"] + GROUPS["lights"],
        "variants": [{"name": "light unknown", "seeds": [0, 1, 2], "train": []}, KNOWN],
    },
    {
        "name": "parts",
        "title": "Without parts of the light",
        "about": "The light unknown; the first table has the same trainings with all parts.",
        "default": True,
        "preset": "draft",
        "resolution": 128,
        "scenes": GROUPS["scenes"] + GROUPS["lights"],
        "variants": [{"name": "without shadows of the sky", "seeds": [0], "train": ["--set", 'shading={"sky_shadows":false}']}],
    },
    {
        "name": "methods",
        "title": "Models of published systems",
        "about": "The models of published systems, re-implemented in this program and trained with its optimiser. This is not the code of their authors.",
        "default": True,
        "preset": "draft",
        "resolution": 128,
        "scenes": ["helmet", "drape", "yard"],
        "variants": [{"name": "relume", "seeds": [0], "train": []}, *map(published, ["article", "r3dg", "gs-ir", "gaussian-shader"])],
    },
    {
        "name": "tiers",
        "title": "Rendering tiers",
        "about": "One training a scene, relit by each tier.",
        "default": True,
        "preset": "draft",
        "resolution": 128,
        "scenes": ["helmet", "drape", "yard"],
        "variants": [
            {"name": tier, "seeds": [0], "train": [], "eval": ["--tier", tier]} for tier in ("preview", "standard", "high", "monte_carlo")
        ],
    },
    {
        "name": "standard",
        "title": "`standard` at 200 px",
        "about": "",
        "default": False,
        "preset": "standard",
        "resolution": 200,
        "scenes": GROUPS["scenes"],
        "variants": [{"name": "light unknown", "seeds": [0], "train": []}],
    },
    {
        "name": "high",
        "title": "`high` at 400 px",
        "about": "",
        "default": False,
        "preset": "high",
        "resolution": 400,
        "scenes": GROUPS["scenes"],
        "variants": [{"name": "light unknown", "seeds": [0], "train": []}],
    },
]
