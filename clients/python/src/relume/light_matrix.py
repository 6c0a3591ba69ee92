"""Light matrices: frames under lobes of light, of which a weighted sum is a frame under any environment.

>>> import relume
>>> matrix = relume.light_matrix.read("matrix.exr")                # doctest: +SKIP
>>> weights = relume.light_matrix.weights(sky, matrix)             # doctest: +SKIP
>>> relume.light_matrix.relight(matrix, weights).shape             # doctest: +SKIP
(512, 512, 3)

The files are those of `relume render --light-matrix` and of the export `light_matrix` (docs/guide/light_matrix.md).
"""

from __future__ import annotations

import json
import os
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt
import OpenEXR

from relume.frames import Plane

Weights = npt.NDArray[np.float64]

# Columns and rows of the map whose texels the lobes divide.
_SIZE = (256, 128)


@dataclass(frozen=True)
class LightMatrix:
    """The frames of a model under each light: lobes of radiance 1, then strong small lights of irradiance 1."""

    names: tuple[str, ...]
    """Names of the parts, in the order of `frames`."""
    directions: npt.NDArray[np.float64]
    """Unit direction of each light, parts x 3."""
    lobes: int
    """Number of lobes, which are the first of the parts."""
    frames: npt.NDArray[Any]
    """Linear Rec.709, premultiplied by `alpha`, parts x height x width x 3, in the number type of the file."""
    alpha: Plane
    """Coverage, height x width."""


def read(path: str | os.PathLike[str]) -> LightMatrix:
    """The light matrix in a file. A file that is not a light matrix raises a ValueError."""
    names: list[str] = []
    directions: list[npt.NDArray[np.float64]] = []
    frames: list[npt.NDArray[Any]] = []
    alpha: Plane | None = None
    lobes = 0
    with OpenEXR.File(os.fspath(path), separate_channels=True) as exr:
        for part in exr.parts:
            name = str(part.header.get("name", ""))
            if "A" in part.channels:
                alpha = np.asarray(part.channels["A"].pixels, dtype=np.float32)
                continue
            direction = part.header.get("relume:direction")
            if direction is None:
                raise ValueError(f"{path}: part {name!r} has no direction: the file is not a light matrix")
            names.append(name)
            directions.append(np.asarray(direction, dtype=np.float64).reshape(3))
            lobes += "relume:solid_angle_sr" in part.header
            frames.append(np.stack([part.channels[f"{name}.{channel}"].pixels for channel in "RGB"], axis=-1))
    if alpha is None or lobes == 0:
        raise ValueError(f"{path}: is not a light matrix; make one with `relume render --light-matrix`")
    return LightMatrix(tuple(names), np.stack(directions), lobes, np.stack(frames), alpha)


def weights(
    environment: npt.ArrayLike, matrix: LightMatrix, *, rotation_deg: float = 0.0, exposure_ev: float = 0.0
) -> Weights:
    """The weights of an equirectangular map (height x width x 3, linear Rec.709, its top row +Z) for a matrix: parts x 3.

    The weight of a lobe is the mean radiance over it. Strong small lights of the map are in the lobes too, and the parts of
    small lights have the weight 0; `load_weights` reads the weights of `relume weights`, which separates them.
    `rotation_deg` turns the map about +Z, counter-clockwise seen from above; `exposure_ev` is in stops.
    """
    texels = np.asarray(environment, dtype=np.float64)
    if texels.ndim != 3 or texels.shape[2] < 3 or 0 in texels.shape:
        raise ValueError(f"environment: must have the shape height x width x 3, not {texels.shape}")
    texels = np.maximum(texels[..., :3], 0.0)
    if not np.isfinite(texels).all():
        raise ValueError("environment: has a texel that is not finite")
    texels = _turned(texels, rotation_deg) * 2.0**exposure_ev
    texels = _resampled(texels)
    found = np.zeros((len(matrix.names), 3))
    towards, lobe_of_texel, solid_angles = _lobes(matrix.lobes)
    if not np.allclose(matrix.directions[: matrix.lobes], towards, atol=1e-4):
        raise ValueError("matrix: has other lobes than this version of the client; render the matrix again")
    totals = np.bincount(lobe_of_texel, solid_angles, minlength=matrix.lobes)
    for channel in range(3):
        products = texels[..., channel].ravel() * solid_angles
        found[: matrix.lobes, channel] = np.bincount(lobe_of_texel, products, minlength=matrix.lobes) / totals
    return found


def load_weights(source: str | os.PathLike[str] | Mapping[str, Any], matrix: LightMatrix) -> Weights:
    """The weights in a JSON file of `relume weights` (or its content) for a matrix: parts x 3."""
    content = source if isinstance(source, Mapping) else json.loads(Path(source).read_text())
    try:
        by_name = {part["part"]: part["rgb"] for part in content["parts"]}
    except (KeyError, TypeError) as error:
        raise ValueError(f"{source}: are not weights; make them with `relume weights`") from error
    missing = [name for name in matrix.names if name not in by_name]
    if missing or len(by_name) != len(matrix.names):
        raise ValueError(f"the weights are those of another matrix: it has {len(by_name)} parts, without {missing[:3]}")
    return np.array([by_name[name] for name in matrix.names], dtype=np.float64)


def relight(matrix: LightMatrix, weights: npt.ArrayLike) -> Plane:
    """The frame under the weighted light: linear Rec.709, premultiplied, float32, height x width x 3.

    `weights` has the shape parts x 3, or parts for a colourless light.
    """
    factors = np.asarray(weights, dtype=np.float64)
    if factors.ndim == 1:
        factors = np.repeat(factors[:, None], 3, axis=1)
    if factors.shape != (len(matrix.names), 3):
        raise ValueError(f"weights: must have the shape {(len(matrix.names), 3)}, not {factors.shape}")
    out = np.zeros(matrix.frames.shape[1:], dtype=np.float64)
    for frame, factor in zip(matrix.frames, factors, strict=True):
        out += frame.astype(np.float64) * factor
    return out.astype(np.float32)


def _lobes(count: int) -> tuple[npt.NDArray[np.float64], npt.NDArray[np.int64], npt.NDArray[np.float64]]:
    """Direction of each lobe, and lobe and solid angle of each texel of the divided map, row-major.

    A texel belongs to the nearest direction of a Fibonacci spiral.
    """
    index = np.arange(count) + 0.5
    z = 1.0 - 2.0 * index / count
    radius = np.sqrt(np.maximum(1.0 - z * z, 0.0))
    phi = np.pi * (1.0 + np.sqrt(5.0)) * index
    towards = np.stack([radius * np.cos(phi), radius * np.sin(phi), z], axis=-1)
    width, height = _SIZE
    theta = (np.arange(height) + 0.5) / height * np.pi
    along = (0.5 - (np.arange(width) + 0.5) / width) * 2.0 * np.pi
    texels = np.stack(
        np.broadcast_arrays(
            np.sin(theta)[:, None] * np.cos(along), np.sin(theta)[:, None] * np.sin(along), np.cos(theta)[:, None]
        ),
        axis=-1,
    )
    nearest = np.argmax(texels.reshape(-1, 3) @ towards.T, axis=1)
    edges = np.cos(np.pi * np.arange(height + 1) / height)
    of_row = (edges[:-1] - edges[1:]) * 2.0 * np.pi / width
    return towards, nearest, np.repeat(of_row, width)


def _turned(texels: npt.NDArray[np.float64], degrees: float) -> npt.NDArray[np.float64]:
    columns = np.radians(degrees) / (2.0 * np.pi) * texels.shape[1]
    whole = np.floor(columns)
    fraction = columns - whole
    left = np.roll(texels, -int(whole), axis=1)
    turned: npt.NDArray[np.float64] = (1.0 - fraction) * left + fraction * np.roll(left, -1, axis=1)
    return turned


def _resampled(texels: npt.NDArray[np.float64]) -> npt.NDArray[np.float64]:
    """The map at the size of the divided map: means by solid angle."""
    height, width = texels.shape[:2]
    columns = _overlaps(np.arange(width + 1) / width, np.arange(_SIZE[0] + 1) / _SIZE[0])
    rows = _overlaps(
        0.5 - 0.5 * np.cos(np.pi * np.arange(height + 1) / height),
        0.5 - 0.5 * np.cos(np.pi * np.arange(_SIZE[1] + 1) / _SIZE[1]),
    )
    means: npt.NDArray[np.float64] = np.einsum("yh,hwc,xw->yxc", rows, texels, columns, optimize=True)
    return means


def _overlaps(old: npt.NDArray[np.float64], new: npt.NDArray[np.float64]) -> npt.NDArray[np.float64]:
    """Share of each old cell in each new one, new x old, from the edges of both."""
    low = np.maximum(new[:-1, None], old[None, :-1])
    high = np.minimum(new[1:, None], old[None, 1:])
    overlaps: npt.NDArray[np.float64] = np.maximum(high - low, 0.0)
    overlaps /= overlaps.sum(axis=1, keepdims=True)
    return overlaps
