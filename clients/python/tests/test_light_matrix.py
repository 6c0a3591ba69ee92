"""Light matrices as files and arrays, without a server."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import numpy.typing as npt
import OpenEXR
import pytest

import relume
from relume.light_matrix import LightMatrix, _lobes

LOBES = 24
SIZE = (5, 7)
RNG = np.random.default_rng(0)
FRAMES = RNG.uniform(-0.01, 1.0, (LOBES + 1, *SIZE, 3)).astype(np.float16)


def write(path: Path) -> None:
    """A file as `relume render --light-matrix` writes it."""
    directions = np.concatenate([_lobes(LOBES)[0], [[0.0, 0.6, 0.8]]])
    kind = {"type": OpenEXR.scanlineimage, "compression": OpenEXR.ZIP_COMPRESSION}
    parts = [OpenEXR.Part({**kind, "name": "alpha"}, {"A": np.full(SIZE, 0.5, np.float16)}, "alpha")]
    for k, (direction, frame) in enumerate(zip(directions, FRAMES, strict=True)):
        name = f"lobe{k + 1:03}" if k < LOBES else "sun001"
        extent = {"relume:solid_angle_sr": 0.5} if k < LOBES else {"relume:radius_deg": 0.3}
        header = {**kind, "name": name, "relume:direction": direction.astype(np.float32), **extent}
        channels = {f"{name}.{c}": np.ascontiguousarray(frame[..., i]) for i, c in enumerate("RGB")}
        parts.append(OpenEXR.Part(header, channels, name))
    with OpenEXR.File(parts) as file:
        file.write(str(path))


@pytest.fixture()
def matrix(tmp_path: Path) -> LightMatrix:
    write(tmp_path / "matrix.exr")
    return relume.light_matrix.read(tmp_path / "matrix.exr")


def combined(weights: npt.NDArray[np.float64]) -> npt.NDArray[np.float64]:
    """The map of 256 x 128 texels that has the weights of lobes."""
    return weights[_lobes(len(weights))[1]].reshape(128, 256, 3)


def test_a_matrix_reads_back(matrix: LightMatrix) -> None:
    assert matrix.lobes == LOBES and len(matrix.names) == LOBES + 1
    assert (matrix.names[0], matrix.names[-1]) == ("lobe001", "sun001")
    assert matrix.frames.dtype == np.float16
    np.testing.assert_array_equal(matrix.frames, FRAMES)
    np.testing.assert_allclose(matrix.directions[-1], [0.0, 0.6, 0.8], atol=1e-6)
    assert matrix.alpha.shape == SIZE and float(matrix.alpha[0, 0]) == 0.5


def test_a_frame_is_the_weighted_sum_of_the_parts(matrix: LightMatrix) -> None:
    weights = RNG.uniform(0.0, 2.0, (LOBES + 1, 3))
    expected = np.einsum("pyxc,pc->yxc", FRAMES.astype(np.float64), weights)
    np.testing.assert_allclose(relume.light_matrix.relight(matrix, weights), expected, rtol=1e-6)
    other = relume.light_matrix.relight(matrix, weights[::-1])
    assert np.abs(other - expected).max() > 0.1, "the control: other weights"
    grey = relume.light_matrix.relight(matrix, weights[:, 0])
    np.testing.assert_array_equal(grey, relume.light_matrix.relight(matrix, np.repeat(weights[:, :1], 3, axis=1)))
    with pytest.raises(ValueError, match=r"weights: must have the shape \(25, 3\)"):
        relume.light_matrix.relight(matrix, weights[:-1])


def test_weights_of_a_map_that_is_even_in_each_lobe(matrix: LightMatrix) -> None:
    wanted = RNG.uniform(0.0, 2.0, (LOBES, 3))
    found = relume.light_matrix.weights(combined(wanted), matrix)
    np.testing.assert_allclose(found[:LOBES], wanted, rtol=1e-9)
    assert not found[LOBES:].any(), "the light is in the lobes"
    twice = relume.light_matrix.weights(combined(wanted), matrix, exposure_ev=1.0)
    np.testing.assert_allclose(twice, 2.0 * found, rtol=1e-9)
    turned = relume.light_matrix.weights(combined(wanted), matrix, rotation_deg=40.0)
    assert np.abs(turned - found).max() > 0.1, "the control: a turned map"
    whole = relume.light_matrix.weights(combined(wanted), matrix, rotation_deg=360.0)
    np.testing.assert_allclose(whole, found, rtol=1e-9)


def test_a_map_is_turned_counter_clockwise(matrix: LightMatrix) -> None:
    """A lamp towards +X is towards +Y after a quarter of a turn."""
    lamp = np.zeros((64, 128, 3))
    lamp[31:33, 63:65] = 100.0

    def brightest(degrees: float) -> npt.NDArray[np.float64]:
        found = relume.light_matrix.weights(lamp, matrix, rotation_deg=degrees)
        towards: npt.NDArray[np.float64] = matrix.directions[np.argmax(found[:, 0])]
        return towards

    assert brightest(0.0) @ [1.0, 0.0, 0.0] > 0.85
    assert brightest(90.0) @ [0.0, 1.0, 0.0] > 0.85
    assert brightest(-90.0) @ [0.0, 1.0, 0.0] < -0.85, "the control"


def test_maps_of_every_size_keep_their_power(matrix: LightMatrix) -> None:
    _, lobe_of_texel, solid_angles = _lobes(LOBES)
    of_lobes = np.bincount(lobe_of_texel, solid_angles)
    for height, width in [(32, 64), (150, 300), (512, 1024)]:
        sky = RNG.uniform(0.0, 3.0, (height, width, 3))
        edges = np.cos(np.pi * np.arange(height + 1) / height)
        rows = (edges[:-1] - edges[1:]) * 2.0 * np.pi / width
        power = np.einsum("hwc,h->c", sky, rows)
        found = relume.light_matrix.weights(sky, matrix)[:LOBES].T @ of_lobes
        np.testing.assert_allclose(found, power, rtol=1e-6)
        assert np.abs(found / (power * 1.001) - 1.0).max() > 1e-4, "the control"


def test_weights_in_json_are_those_of_the_same_matrix(matrix: LightMatrix, tmp_path: Path) -> None:
    content = {"parts": [{"part": name, "rgb": [k, 2 * k, 0.5]} for k, name in enumerate(matrix.names)]}
    found = relume.light_matrix.load_weights({"parts": content["parts"][::-1]}, matrix)
    np.testing.assert_array_equal(found[3], [3, 6, 0.5])
    with pytest.raises(ValueError, match="another matrix: it has 24 parts, without"):
        relume.light_matrix.load_weights({"parts": content["parts"][1:]}, matrix)
    (tmp_path / "other.json").write_text('{"weights": []}')
    with pytest.raises(ValueError, match="are not weights"):
        relume.light_matrix.load_weights(tmp_path / "other.json", matrix)


def test_other_files_and_maps_are_refused(matrix: LightMatrix, tmp_path: Path) -> None:
    pixels = np.zeros((*SIZE, 3), np.float32)
    with OpenEXR.File({"compression": OpenEXR.ZIP_COMPRESSION, "type": OpenEXR.scanlineimage}, {"RGB": pixels}) as file:
        file.write(str(tmp_path / "frame.exr"))
    with pytest.raises(ValueError, match="light matrix"):
        relume.light_matrix.read(tmp_path / "frame.exr")
    for wrong, reason in [(np.zeros((4, 8)), "shape"), (np.full((4, 8, 3), np.nan), "not finite")]:
        with pytest.raises(ValueError, match=reason):
            relume.light_matrix.weights(wrong, matrix)
    swapped = LightMatrix(matrix.names, matrix.directions[::-1], matrix.lobes, matrix.frames, matrix.alpha)
    with pytest.raises(ValueError, match="has other lobes"):
        relume.light_matrix.weights(np.ones((4, 8, 3)), swapped)
