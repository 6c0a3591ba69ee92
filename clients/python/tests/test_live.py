"""Against a real server: RELUME_SERVER is its address, RELUME_API_KEY its key, RELUME_CAPTURE a capture to train on."""

from __future__ import annotations

import os
import zipfile
from pathlib import Path

import numpy as np
import numpy.typing as npt
import OpenEXR
import pytest

import relume
from relume.light_matrix import _lobes

pytestmark = pytest.mark.skipif("RELUME_SERVER" not in os.environ, reason="needs a server: .ci/python starts one")

SHORT = {"iterations": 40, "resolution": 48, "max_gaussians": 300}


@pytest.fixture(scope="module")
def client() -> relume.Client:
    return relume.Client(os.environ["RELUME_SERVER"])


@pytest.fixture(scope="module")
def trained(client: relume.Client) -> tuple[relume.Capture, relume.Model]:
    capture = client.upload_capture(os.environ["RELUME_CAPTURE"], name="sample")
    job = capture.train("draft", overrides=SHORT, name="short", labels={"of": "tests"})
    return capture, job.wait(progress=False)


def test_a_round(client: relume.Client, trained: tuple[relume.Capture, relume.Model], tmp_path: Path) -> None:
    capture, model = trained
    assert capture.data["name"] == "sample"
    assert {job.data["name"] for job in client.jobs(label="of:tests")} == {"short"}
    assert not list(client.jobs(label="of:nothing"))
    outputs = ["rgb", "albedo", "normal", "depth", "roughness", "metallic", "visibility"]
    frame = model.render(relume.orbit(30, 20), "sunset", size=(64, 48), outputs=outputs)
    assert set(frame) == {*outputs, "alpha"}
    assert all(plane.shape[:2] == (48, 64) and plane.dtype == np.float32 for plane in frame.values())
    assert frame["rgb"].shape == (48, 64, 3) and frame["depth"].shape == (48, 64)
    assert frame["alpha"].max() > 0.5 and frame["alpha"].min() < 0.5, "there is a thing, and something around it"
    brighter = model.render(relume.orbit(30, 20), "sunset", size=(64, 48), exposure_ev=1.0)
    np.testing.assert_allclose(brighter["rgb"], 2 * frame["rgb"], rtol=1e-4, atol=1e-6)
    other = model.render(relume.orbit(30, 20), "night", size=(64, 48))
    assert np.abs(other["rgb"] - frame["rgb"]).max() > 0.01, "the control: another light shows"
    assert model.download("model.safetensors", tmp_path / "m").stat().st_size > 1000
    assert model.card


def test_files_are_made_on_the_server(trained: tuple[relume.Capture, relume.Model], tmp_path: Path) -> None:
    model = trained[1]
    around = model.export("frames", "sunset", turntable={"frames": 3}, width=32, height=24, format="exr").wait(progress=False)
    with zipfile.ZipFile(around.save(tmp_path)) as frames:
        assert frames.namelist() == ["0001.exr", "0002.exr", "0003.exr"]
        first, second = (relume.Frame.from_exr(frames.read(name)) for name in frames.namelist()[:2])
    assert first["rgb"].shape == (24, 32, 3)
    assert np.abs(first["rgb"] - second["rgb"]).max() > 0.01, "the control: from another side"
    albedo = model.export("ply", layer="albedo").wait(progress=False).save(tmp_path / "albedo.ply")
    assert albedo.read_bytes().startswith(b"ply")
    with pytest.raises(relume.RelumeError) as caught:
        model.export("ply", layer="depth")
    assert caught.value.errors[0]["pointer"] == "/layer"
    long = model.export("frames", turntable={"frames": 10_000})
    long.cancel()
    with pytest.raises(relume.ExportFailed, match="cancelled"):
        long.wait(progress=False, timeout=60)
    long.delete()


def test_a_weighted_sum_of_a_light_matrix_is_the_frame(
    client: relume.Client, trained: tuple[relume.Capture, relume.Model], tmp_path: Path
) -> None:
    model, camera = trained[1], relume.orbit(30, 20)
    export = model.export("light_matrix", camera=camera, width=64, height=48, lobes=32).wait(progress=False)
    matrix = relume.light_matrix.read(export.save(tmp_path / "matrix.exr"))
    assert matrix.frames.shape == (32, 48, 64, 3) and matrix.lobes == 32
    x, y, z = matrix.directions.T
    even = np.stack([1.2 + z, 1.0 + 0.5 * x, 0.8 + 0.6 * y * z], axis=-1)
    # A map that is even in each lobe: the texels of the divided map have the weight of their lobe.
    sky = even[_lobes(32)[1]].reshape(128, 256, 3).astype(np.float32)
    header = {"compression": OpenEXR.ZIP_COMPRESSION, "type": OpenEXR.scanlineimage}
    with OpenEXR.File(header, {"RGB": sky}) as file:
        file.write(str(tmp_path / "sky.exr"))
    frame = model.render(camera, client.upload_environment(tmp_path / "sky.exr"), size=(64, 48))["rgb"]

    def error(weights: npt.NDArray[np.float64]) -> float:
        return float(np.linalg.norm(relume.light_matrix.relight(matrix, weights) - frame) / np.linalg.norm(frame))

    weights = relume.light_matrix.weights(sky, matrix)
    assert error(weights) < 1e-3, "half floats"
    assert error(weights[::-1]) > 0.05, "the control: the weights of other lobes"
    turned = model.render(camera, client.upload_environment(tmp_path / "sky.exr"), size=(64, 48), rotation_deg=90.0)["rgb"]
    of_turned = relume.light_matrix.weights(sky, matrix, rotation_deg=90.0)
    summed = relume.light_matrix.relight(matrix, of_turned)
    # The turned map is not even in each lobe.
    assert np.linalg.norm(summed - turned) < 0.05 * np.linalg.norm(turned)
    assert np.linalg.norm(summed - frame) > 0.1 * np.linalg.norm(frame), "the control: the map as it was"


def test_a_linear_frame_is_the_picture_that_the_server_shows(trained: tuple[relume.Capture, relume.Model]) -> None:
    image = pytest.importorskip("matplotlib.image")
    capture, model = trained
    photograph = capture.cameras()[0]
    size = (photograph["width"], photograph["height"])
    (Path(os.environ["RELUME_CAPTURE"]).parent / "shown.png").write_bytes(
        model.picture(photograph["camera"], size=size, background="#ffffff")
    )
    shown = image.imread(Path(os.environ["RELUME_CAPTURE"]).parent / "shown.png")[..., :3]
    frame = model.render(photograph["camera"], size=size)
    assert np.abs(frame.srgb(background=1.0) - shown).max() < 0.01
    assert np.abs(frame.srgb(exposure_ev=0.5, background=1.0) - shown).max() > 0.02, "the control"


def test_materials_are_listed_and_change_pictures(trained: tuple[relume.Capture, relume.Model], tmp_path: Path) -> None:
    model, camera = trained[1], relume.orbit(30, 20)
    materials = model.materials()
    assert [one["material"] for one in materials] == list(range(len(materials)))
    assert abs(sum(one["share"] for one in materials) - 1.0) < 1e-3
    black = [{"material": one["material"], "colour": "#000000"} for one in materials]
    dark = model.render(camera, size=32, outputs=("albedo",), materials=black)["albedo"]
    plain = model.render(camera, size=32, outputs=("albedo",))["albedo"]
    assert dark.max() < 0.02 < 0.1 < plain.max(), "the control: the model itself is not black"
    masks = {model.material_mask(one["material"], size=32) for one in materials}
    assert all(mask.startswith(b"\x89PNG") for mask in masks) and len(masks) == len(materials)
    with pytest.raises(relume.RelumeError) as caught:
        model.export("ply", materials=[{"material": 999, "scale": 2.0}])
    assert caught.value.errors[0]["pointer"] == "/materials/0/material"


def test_a_thumbnail_has_its_size_light_and_direction(trained: tuple[relume.Capture, relume.Model]) -> None:
    model = trained[1]
    first = model.thumbnail("sunset", size=48)
    assert first.startswith(b"\x89PNG") and first[16:24] == bytes([0, 0, 0, 48, 0, 0, 0, 48])
    assert model.thumbnail("sunset", size=48, azimuth_deg=0) == first, "without an azimuth it is that of the first photograph"
    others = [
        model.thumbnail("night", size=48),
        model.thumbnail("sunset", size=48, azimuth_deg=90),
        model.thumbnail("sunset", size=48, elevation_deg=80),
        model.thumbnail("sunset", size=48, background="f4f4f4"),
    ]
    assert len({first, *others}) == 5, "the control: light, direction and background show"
    with pytest.raises(relume.RelumeError) as caught:
        model.thumbnail(size=8)
    assert caught.value.status in (400, 422)


def test_photographs_are_listed_and_shown(trained: tuple[relume.Capture, relume.Model]) -> None:
    capture, _ = trained
    first, second = capture.photographs()[:2]
    assert first["camera"] == capture.cameras()[0]["camera"] and isinstance(first["warnings"], list)
    small = capture.photograph(first["name"], width=32, undistorted=True)
    assert small.startswith(b"\xff\xd8\xff") and len(small) < len(capture.photograph(first["name"]))
    assert small != capture.photograph(second["name"], width=32, undistorted=True), "the control"
    with pytest.raises(relume.RelumeError) as caught:
        capture.photograph("../transforms.json")
    assert caught.value.status == 404


def test_a_map_is_uploaded_and_deleted(client: relume.Client, trained: tuple[relume.Capture, relume.Model], tmp_path: Path) -> None:
    header = b"#?RADIANCE\nFORMAT=32-bit_rle_rgbe\n\n-Y 1 +X 2\n"
    (tmp_path / "light.hdr").write_bytes(header + bytes([128, 128, 128, 129, 64, 96, 160, 130]))
    light = client.upload_environment(tmp_path / "light.hdr", name="two texels")
    frame = trained[1].render(relume.orbit(0), light, size=32)
    assert frame["rgb"].max() > 0
    light.delete()
    with pytest.raises(relume.RelumeError) as caught:
        trained[1].render(relume.orbit(0), light, size=32)
    assert caught.value.status in (404, 422)


def test_what_is_refused_names_the_field(trained: tuple[relume.Capture, relume.Model]) -> None:
    with pytest.raises(relume.RelumeError) as caught:
        trained[1].render(relume.orbit(0), "nowhere", size=32)
    assert caught.value.status == 422 and "environment" in str(caught.value)
    with pytest.raises(relume.RelumeError) as caught:
        trained[0].train("draft", overrides={"iterations": -1})
    assert caught.value.status in (400, 422)


def test_what_is_needed_stays_and_what_is_deleted_is_gone(
    client: relume.Client, trained: tuple[relume.Capture, relume.Model]
) -> None:
    capture, model = trained
    job = capture.train("draft", overrides={**SHORT, "iterations": 100_000})
    with pytest.raises(relume.RelumeError) as caught:
        capture.delete()
    assert (caught.value.status, caught.value.kind) == (409, "in-use")
    job.cancel()
    with pytest.raises(relume.JobFailed, match="cancelled"):
        job.wait(progress=False, timeout=60)
    capture.delete(cascade=True)
    model.delete()
    with pytest.raises(relume.RelumeError) as caught:
        client.capture(capture.id)
    assert caught.value.status == 404
