"""Where a frame is seen from, in the coordinates of the capture: +Z is up."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Any, Literal

Camera = dict[str, Any]
"""A camera as a render takes it; also what `Capture.cameras` gives."""


def look_at(
    eye: Sequence[float],
    target: Sequence[float] = (0.0, 0.0, 0.0),
    *,
    fov_y_deg: float = 40.0,
    up: Sequence[float] = (0.0, 0.0, 1.0),
) -> Camera:
    """A camera at `eye` that looks at `target`, of a vertical field of view in degrees."""
    return {"look_at": {"eye": list(eye), "target": list(target), "up": list(up), "fov_y_deg": fov_y_deg}}


def orbit(
    azimuth_deg: float,
    elevation_deg: float = 20.0,
    distance: float = 4.0,
    target: Sequence[float] = (0.0, 0.0, 0.0),
    *,
    fov_y_deg: float = 40.0,
) -> Camera:
    """A camera around `target`: degrees counter-clockwise seen from above (0 on the +x side), degrees above the horizon."""
    a, e = math.radians(azimuth_deg), math.radians(elevation_deg)
    away = (math.cos(e) * math.cos(a), math.cos(e) * math.sin(a), math.sin(e))
    return look_at([t + distance * d for t, d in zip(target, away, strict=True)], target, fov_y_deg=fov_y_deg)


def matrix(
    camera_to_world: Sequence[Sequence[float]],
    *,
    fov_y_deg: float,
    axes: Literal["opengl", "opencv"] = "opengl",
) -> Camera:
    """A camera of a 4x4 matrix, rows first, whose columns are `axes` of the camera (`opengl`: it looks along -z; `opencv`: along +z)."""
    rows = [[float(v) for v in row] for row in camera_to_world]
    return {"camera_to_world": rows, "axes": axes, "fov_y_deg": fov_y_deg}
