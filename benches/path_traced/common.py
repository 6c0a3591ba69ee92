"""What references.py and scores.py have in common: lamps, the changed colour and names of files. Needs only the standard library."""

# Lamps as `--lamp` of `relume render` takes them: the shape and its fields.
LAMPS = {
    "bulb": {"shape": "point", "position": (1.0, 0.5, 1.0), "radius": 0.08, "intensity": 2.0},
    "soft box": {"shape": "rectangle", "position": (-1.2, -0.8, 0.9), "target": (0.0, 0.0, 0.0), "size": (0.8, 0.4), "intensity": 6.0},
    "spot": {"shape": "spot", "position": (0.6, -0.6, 1.3), "target": (0.0, 0.0, 0.0), "cone": 40.0, "radius": 0.02, "intensity": 4.0},
}
# Share of the half angle of a spot that is its soft edge.
SOFT_EDGE = 0.2

# Base colour, linear, of the table below the monkey and the blocks.
TABLE = (0.55, 0.42, 0.30)
# Base colour, linear, of the material that changes: the monkey's head, the table below the blocks, the cloth; and its new colour, sRGB.
CHANGED = {"monkey": (0.55, 0.25, 0.12), "blocks": TABLE, "cloth": (0.30, 0.045, 0.035)}
NEW_COLOUR = "#305095"

KINDS = ("ground", "lamps", "materials")


def lamp_text(lamp):
    """A lamp as the argument of `--lamp`."""
    def text(value):
        return ",".join(f"{v:g}" for v in value) if isinstance(value, tuple) else f"{value:g}"

    return " ".join([lamp["shape"], *(f"{key}={text(value)}" for key, value in lamp.items() if key != "shape")])


def mirrored(lamp):
    """The lamp on the other side of the vertical axis."""
    x, y, z = lamp["position"]
    return {**lamp, "position": (-x, -y, z)}


def linear(colour):
    """Linear values of a colour such as `#305095`."""
    encoded = [int(colour[k : k + 2], 16) / 255 for k in (1, 3, 5)]
    return tuple(v / 12.92 if v <= 0.04045 else ((v + 0.055) / 1.055) ** 2.4 for v in encoded)


def plane_file(light):
    return f"ground/{light}-without.exr"


def ground_file(place, light, view):
    return f"ground/{place}-{light}-{view}.exr"


def lamp_file(name, view):
    return f"lamps/{name.replace(' ', '-')}-{view}.exr"


def material_file(light, view, is_changed):
    return f"materials/{light}-{view}-{'changed' if is_changed else 'as-it-is'}.exr"


def mask_file(view):
    return f"materials/mask-{view}.exr"
