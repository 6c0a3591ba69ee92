"""What a server keeps: captures, jobs, models, environment maps."""

from __future__ import annotations

import os
import tempfile
import time
import uuid
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any, Literal
from urllib.parse import quote

from tqdm import tqdm

from relume.cameras import Camera
from relume.errors import ExportFailed, JobFailed, RelumeError
from relume.frames import Frame
from relume.http import Connection

Preset = Literal["draft", "standard", "high"]
Tier = Literal["preview", "standard", "high", "monte_carlo"]
_ENDED = ("succeeded", "rejected", "failed", "cancelled")
ExportKind = Literal["frames", "gltf", "usd", "usdz", "ply", "mesh", "light_matrix", "delight"]


class Resource:
    """Something that the server keeps. `data` is its JSON as it was last asked for."""

    _path = ""

    def __init__(self, connection: Connection, data: dict[str, Any]) -> None:
        self._connection = connection
        self.data = data

    @property
    def id(self) -> str:
        """Its identifier."""
        return str(self.data["id"])

    def __repr__(self) -> str:
        return f"{type(self).__name__}({self.id})"

    def refresh(self) -> None:
        """Asks for it again."""
        self.data = self._connection.json("GET", self._at())

    def delete(self, *, cascade: bool = False) -> None:
        """Deletes it; with `cascade` also what needs it, otherwise that is a RelumeError of kind `in-use`."""
        self._connection.send("DELETE", self._at(), params={"cascade": "true"} if cascade else {})

    def _at(self, more: str = "") -> str:
        return f"/v1/{self._path}/{self.id}{more}"


class Capture(Resource):
    """Photographs with their cameras."""

    _path = "captures"

    @property
    def state(self) -> str:
        """`ready`, `validating` or `invalid`, as it was last asked for."""
        return str(self.data.get("state", "ready"))

    def wait(self, *, timeout: float | None = None, on_progress: Callable[[dict[str, Any]], None] | None = None) -> Capture:
        """Waits until it is ready, where the server finds the poses of its photographs first, and gives itself.

        `on_progress` is told each new state of the capture's JSON, whose `poses` say how far that is. Raises RelumeError when it became
        invalid; `log()` has what COLMAP said. Raises TimeoutError after `timeout` seconds.
        """
        until = None if timeout is None else time.monotonic() + timeout
        while self.state == "validating":
            if until is not None and time.monotonic() > until:
                raise TimeoutError(f"capture {self.id} is {self.state} after {timeout} s")
            time.sleep(1.0)
            self.refresh()
            if on_progress is not None:
                on_progress(self.data)
        if self.state == "invalid":
            problem = self.data.get("problem") or {}
            raise RelumeError(int(problem.get("status", 422)), problem)
        return self

    def log(self) -> str:
        """What COLMAP said while it found the poses; empty where the photographs came with them."""
        return self._connection.send("GET", self._at("/log")).text

    def cameras(self) -> list[dict[str, Any]]:
        """Each photograph's `name`, `width`, `height`, `held_out` and `camera`, which is one that `Model.render` takes."""
        cameras: list[dict[str, Any]] = self._connection.json("GET", self._at("/cameras"))["cameras"]
        return cameras

    def photographs(self) -> list[dict[str, Any]]:
        """Each photograph as `cameras` has it, with the `warnings` of the validation about it."""
        listed: list[dict[str, Any]] = self._connection.json("GET", self._at("/photographs"))["photographs"]
        return listed

    def photograph(self, name: str, *, width: int | None = None, undistorted: bool = False) -> bytes:
        """A photograph as a JPEG of at most `width` pixels from left to right.

        With `undistorted` it lies on a frame that `Model.render` makes for its camera.
        """
        params: dict[str, Any] = {"undistorted": "true"} if undistorted else {}
        if width is not None:
            params["width"] = width
        return self._connection.send("GET", self._at(f"/photographs/{quote(name, safe='')}"), params=params).content

    def train(
        self,
        preset: Preset = "standard",
        *,
        overrides: dict[str, Any] | None = None,
        quality_gate: dict[str, str] | None = None,
        name: str | None = None,
        labels: dict[str, str] | None = None,
        priority: int = 0,
    ) -> Job:
        """Queues a training; once, also when the answer is lost on the way.

        `overrides` are settings of the training (docs/MODEL.md, openapi.json: TrainOverrides); a `quality_gate` such as
        `{"novel_view.psnr": ">=28"}` has the job end as rejected where the model misses it.
        """
        wanted: dict[str, Any] = {"capture": self.id, "preset": preset, "priority": priority}
        named = {"overrides": overrides, "quality_gate": quality_gate, "name": name, "labels": labels}
        wanted.update({key: value for key, value in named.items() if value is not None})
        headers = {"Idempotency-Key": str(uuid.uuid4())}
        return Job(self._connection, self._connection.json("POST", "/v1/jobs", json=wanted, headers=headers))


class Job(Resource):
    """A training."""

    _path = "jobs"

    @property
    def state(self) -> str:
        """`queued`, `running`, `cancelling`, `succeeded`, `rejected`, `failed` or `cancelled`, when it was last asked for."""
        return str(self.data["state"])

    @property
    def has_ended(self) -> bool:
        """Whether it will not change any more."""
        return self.state in _ENDED

    @property
    def figures(self) -> dict[str, Any] | None:
        """What was measured on held-out photographs."""
        figures: dict[str, Any] | None = self.data.get("figures")
        return figures

    def cancel(self) -> None:
        """Asks for its end."""
        self.data = self._connection.json("POST", self._at("/cancel"))

    def model(self) -> Model:
        """The model of a job that succeeded, or was rejected. Raises JobFailed where there is none."""
        if not self.data.get("model"):
            raise JobFailed(self.data)
        return Model(self._connection, self._connection.json("GET", f"/v1/models/{self.data['model']}"))

    def wait(
        self,
        *,
        progress: bool = True,
        timeout: float | None = None,
        on_progress: Callable[[dict[str, Any]], None] | None = None,
    ) -> Model:
        """Waits for the end and gives the model.

        `progress` shows a bar, `on_progress` is told each new state of the job's JSON. Raises JobFailed when the job failed, was cancelled or
        rejected, and TimeoutError after `timeout` seconds; the job goes on then.
        """
        until = None if timeout is None else time.monotonic() + timeout
        total = int(self.data["progress"]["total"])
        with tqdm(total=total, unit="step", desc=self.data.get("name") or "training", disable=not progress) as bar:
            while True:
                self.refresh()
                if on_progress is not None:
                    on_progress(self.data)
                told = self.data["progress"]
                bar.total = int(told["total"])
                shown = {"psnr": told.get("psnr"), "gaussians": told.get("gaussians")}
                bar.set_postfix({key: f"{value:.4g}" for key, value in shown.items() if value is not None}, refresh=False)
                bar.update(int(told["step"]) - bar.n)
                if self.has_ended:
                    break
                if until is not None and time.monotonic() > until:
                    raise TimeoutError(f"job {self.id} is {self.state} after {timeout} s")
                time.sleep(1.0)
        if self.state != "succeeded":
            raise JobFailed(self.data)
        return self.model()


class Environment(Resource):
    """An environment map that was uploaded."""

    _path = "environments"


Light = str | Environment
"""The name of a built-in map, `recovered`, or a map that was uploaded."""


class Model(Resource):
    """A relightable model."""

    _path = "models"

    @property
    def card(self) -> dict[str, Any]:
        """What was trained, how, and what was decided on what evidence."""
        card: dict[str, Any] = self._connection.json("GET", self._at("/card"))
        return card

    @property
    def calibration(self) -> dict[str, Any] | None:
        """The calibration by a surface of known reflectance, as it was last asked for; None if there is none."""
        calibration: dict[str, Any] | None = self.data.get("calibration")
        return calibration

    def calibrate(self, photo: str, rectangle: tuple[int, int, int, int], reflectance: float | Sequence[float]) -> dict[str, Any]:
        """Scales the albedo to a surface of known linear `reflectance`, 0.01 to 1: one number, or red, green and blue.

        `photo` is a photograph of the model's capture, and `rectangle` its part with the surface: left, top, width and height in pixels of
        the stored photograph. The light is divided by the same factors. The files of the model change. Gives the calibration.
        """
        x, y, width, height = rectangle
        patch = {"photo": photo, "x": x, "y": y, "width": width, "height": height}
        known = reflectance if isinstance(reflectance, (int, float)) else list(reflectance)
        self.data = self._connection.json("PUT", self._at("/calibration"), json={"patch": patch, "reflectance": known})
        return self.calibration or {}

    def undo_calibration(self) -> None:
        """Undoes all calibrations since the training."""
        self.data = self._connection.json("DELETE", self._at("/calibration"))

    def materials(self) -> list[dict[str, Any]]:
        """The materials: number, mean colour, share of the surface, roughness and metalness of each.

        `materials` of `render`, `picture` and `export` changes them, e.g. `[{"material": 3, "colour": "#224488", "roughness": 0.4}]`.
        """
        return list(self._connection.json("GET", self._at("/materials"))["items"])

    def material_mask(
        self, material: int, *, size: int = 256, azimuth_deg: float | None = None, elevation_deg: float | None = None
    ) -> bytes:
        """Where the model has a material, as the bytes of a PNG: white where the surface has only this material. Views as in `thumbnail`."""
        angles = {"azimuth": azimuth_deg, "elevation": elevation_deg}
        params: dict[str, Any] = {"size": size, **{name: value for name, value in angles.items() if value is not None}}
        return self._connection.send("GET", self._at(f"/materials/{material}/mask"), params=params).content

    def next_photographs(self, count: int = 10, *, path: dict[str, Any] | None = None) -> dict[str, Any]:
        """The places from which further photographs would help most: `cameras`, the most helpful first.

        Each has `camera`, `width`, `height`, `azimuth_deg`, `elevation_deg`, `nearest_deg` and `lack_of_confidence`. `path` has the cameras
        among which to choose; by default a grid around the subject. An export of frames accepts the result as its `path`.
        """
        wanted = {"count": count, **({} if path is None else {"path": path})}
        return dict(self._connection.json("POST", self._at("/next-photographs"), json=wanted))

    def render(
        self,
        camera: Camera,
        environment: Light = "recovered",
        *,
        size: int | tuple[int, int] = 512,
        outputs: Sequence[str] = ("rgb",),
        tier: Tier = "standard",
        rotation_deg: float = 0.0,
        exposure_ev: float = 0.0,
        samples: int | None = None,
        seed: int | None = None,
        materials: Sequence[dict[str, Any]] = (),
        ground_height: float | None = None,
        lamps: Sequence[dict[str, Any]] = (),
    ) -> Frame:
        """A frame as linear arrays, its `alpha` among them. `size` is width and height, or both. `materials` are changes of materials.

        `ground_height` is the height of the ground for the outputs `shadow`, `bounce` and `contact`; by default the lowest visible point of the model.
        `lamps` are lights at a place, e.g. `{"shape": "point", "position": [1, 0, 2], "intensity": 20, "kelvin": 3200}`.
        """
        asked = self._request(camera, environment, size, [*dict.fromkeys([*outputs, "alpha"])], tier, rotation_deg, exposure_ev)
        drawn = {"samples": samples, "seed": seed, "materials": [*materials] or None, "ground_height": ground_height, "lamps": [*lamps] or None}
        asked.update({key: value for key, value in drawn.items() if value is not None})
        answer = self._connection.send("POST", self._at("/render"), json=asked, headers={"Accept": "image/x-exr"})
        return Frame.from_exr(answer.content)

    def picture(
        self,
        camera: Camera,
        environment: Light = "recovered",
        *,
        size: int | tuple[int, int] = 512,
        output: str = "rgb",
        tier: Tier = "standard",
        rotation_deg: float = 0.0,
        exposure_ev: float = 0.0,
        background: str = "transparent",
        tone_curve: str = "srgb",
        media_type: Literal["image/png", "image/jpeg"] = "image/png",
        materials: Sequence[dict[str, Any]] = (),
        lamps: Sequence[dict[str, Any]] = (),
    ) -> bytes:
        """A frame as the bytes of a PNG or JPEG, for people to look at. `materials` are changes of materials, `lamps` lights at a place."""
        asked = self._request(camera, environment, size, [output], tier, rotation_deg, exposure_ev)
        asked.update({"background": background, "tone_curve": tone_curve, "materials": [*materials], "lamps": [*lamps]})
        return self._connection.send("POST", self._at("/render"), json=asked, headers={"Accept": media_type}).content

    def thumbnail(
        self,
        environment: Light = "recovered",
        *,
        size: int = 256,
        azimuth_deg: float | None = None,
        elevation_deg: float | None = None,
        tier: Literal["preview", "standard", "high"] = "preview",
        background: str = "transparent",
    ) -> bytes:
        """A picture of the whole model as the bytes of a PNG of `size` x `size` pixels, 16 to 1024.

        `azimuth_deg` counts counter-clockwise from the first photograph, `elevation_deg` from the horizon; omitted: the view of the first
        photograph at the median elevation of all.
        """
        env = environment.id if isinstance(environment, Environment) else environment
        params: dict[str, Any] = {"env": env, "size": size, "tier": tier, "background": background}
        angles = {"azimuth": azimuth_deg, "elevation": elevation_deg}
        params.update({name: value for name, value in angles.items() if value is not None})
        return self._connection.send("GET", self._at("/thumbnail"), params=params).content

    def download(self, name: str, path: str | os.PathLike[str]) -> Path:
        """Writes one of the model's files, e.g. `model.safetensors`, to `path`; whole or not at all."""
        return _saved(self._connection, self._at(f"/files/{name}"), path)

    def export(
        self,
        kind: ExportKind,
        environment: Light | None = None,
        *,
        rotation_deg: float = 0.0,
        exposure_ev: float = 0.0,
        **options: Any,
    ) -> Export:
        """Has the server make a file of the model; once, also when the answer is lost on the way.

        `options` are those of the kind (openapi.json: FramesExport, SplatsExport, MeshExport, LightMatrixExport, DelightExport), e.g.
        `model.export("frames", "sunset", turntable={"frames": 120}, package="mp4")` or `model.export("ply", layer="albedo")`.
        """
        wanted: dict[str, Any] = {"kind": kind, **options}
        if environment is not None:
            wanted["environment"] = _light(environment, rotation_deg, exposure_ev)
        headers = {"Idempotency-Key": str(uuid.uuid4())}
        return Export(self._connection, self._connection.json("POST", self._at("/exports"), json=wanted, headers=headers))

    def _request(
        self,
        camera: Camera,
        environment: Light,
        size: int | tuple[int, int],
        outputs: list[str],
        tier: Tier,
        rotation_deg: float,
        exposure_ev: float,
    ) -> dict[str, Any]:
        width, height = (size, size) if isinstance(size, int) else size
        return {
            "camera": camera,
            "environment": _light(environment, rotation_deg, exposure_ev),
            "width": width,
            "height": height,
            "outputs": outputs,
            "tier": tier,
        }


class Export(Resource):
    """A file that is made of a model in the background."""

    _path = "exports"

    @property
    def state(self) -> str:
        """`queued`, `running`, `succeeded`, `failed` or `cancelled`, when it was last asked for."""
        return str(self.data["state"])

    @property
    def has_ended(self) -> bool:
        """Whether it will not change any more."""
        return self.state in _ENDED

    def cancel(self) -> None:
        """Stops it. One that has ended is deleted with its file."""
        self._connection.send("DELETE", self._at())

    def wait(self, *, progress: bool = True, timeout: float | None = None) -> Export:
        """Waits for the file and gives the export.

        `progress` shows a bar. Raises ExportFailed when it failed or was cancelled, and TimeoutError after `timeout` seconds; the export
        goes on then.
        """
        until = None if timeout is None else time.monotonic() + timeout
        total = int(self.data["progress"]["total"])
        with tqdm(total=total, desc=str(self.data["kind"]), disable=not progress) as bar:
            while True:
                self.refresh()
                bar.update(int(self.data["progress"]["done"]) - bar.n)
                if self.has_ended:
                    break
                if until is not None and time.monotonic() > until:
                    raise TimeoutError(f"export {self.id} is {self.state} after {timeout} s")
                time.sleep(0.5)
        if self.state != "succeeded":
            raise ExportFailed(self.data)
        return self

    def save(self, path: str | os.PathLike[str]) -> Path:
        """Writes its file to `path`, or into it under the name that it has where that is a folder; whole or not at all."""
        target = Path(path)
        if target.is_dir():
            target = target / str((self.data.get("file") or {}).get("name", self.id))
        return _saved(self._connection, self._at("/file"), target)


def _light(environment: Light, rotation_deg: float, exposure_ev: float) -> dict[str, Any]:
    light: dict[str, Any] = {"rotation_deg": rotation_deg, "exposure_ev": exposure_ev}
    if isinstance(environment, Environment):
        light["id"] = environment.id
    elif environment != "recovered":
        light["builtin"] = environment
    return light


def _saved(connection: Connection, path: str, to: str | os.PathLike[str]) -> Path:
    """Downloads a file; whole or not at all."""
    target = Path(to)
    handle, unfinished = tempfile.mkstemp(dir=target.parent, prefix=f".{target.name}.")
    try:
        with os.fdopen(handle, "wb") as file:
            connection.save(path, file)
        os.replace(unfinished, target)
    finally:
        Path(unfinished).unlink(missing_ok=True)
    return target
