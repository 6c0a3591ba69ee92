"""Frames as arrays."""

from __future__ import annotations

import os
import tempfile
from collections.abc import Iterator, Mapping
from pathlib import Path

import numpy as np
import numpy.typing as npt
import OpenEXR

Plane = npt.NDArray[np.float32]

# Channels of the file by output; the file has one part for colours and one for measurements.
_CHANNELS = {
    "rgb": ("R", "G", "B"),
    "albedo": ("albedo.R", "albedo.G", "albedo.B"),
    "diffuse": ("diffuse.R", "diffuse.G", "diffuse.B"),
    "specular": ("specular.R", "specular.G", "specular.B"),
    "radiance": ("radiance.R", "radiance.G", "radiance.B"),
    "normal": ("N.X", "N.Y", "N.Z"),
    "depth": ("Z",),
    "metallic": ("metallic.Y",),
    "roughness": ("roughness.Y",),
    "visibility": ("visibility.Y",),
    "position": ("P.X", "P.Y", "P.Z"),
    "shadow": ("shadow.R", "shadow.G", "shadow.B"),
    "shadow_key": ("shadow_key.R", "shadow_key.G", "shadow_key.B"),
    "shadow_fill": ("shadow_fill.R", "shadow_fill.G", "shadow_fill.B"),
    "bounce": ("bounce.R", "bounce.G", "bounce.B"),
    "lamp_light": ("lamp_light.R", "lamp_light.G", "lamp_light.B"),
    "lamp_shadow": ("lamp_shadow.R", "lamp_shadow.G", "lamp_shadow.B"),
    "contact": ("contact.Y",),
    "confidence": ("confidence.Y",),
    "motion": ("forward.u", "forward.v", "backward.u", "backward.v"),
    "material_id": ("material_id.Y",),
    "cryptomatte": tuple(f"CryptoMaterial{layer:02}.{channel}" for layer in range(3) for channel in "RGBA"),
}


class Frame(Mapping[str, Plane]):
    """The outputs of a frame by name, as float32 arrays of height x width (x channels).

    Colours are linear Rec.709 and premultiplied by `alpha`, albedo is not; normals are unit vectors of the capture's axes; depth is
    along the camera's axis in units of the capture, infinite where nothing is.
    """

    def __init__(self, planes: dict[str, Plane]) -> None:
        self._planes = planes

    def __getitem__(self, output: str) -> Plane:
        return self._planes[output]

    def __iter__(self) -> Iterator[str]:
        return iter(self._planes)

    def __len__(self) -> int:
        return len(self._planes)

    def __repr__(self) -> str:
        shapes = ", ".join(f"{name}: {plane.shape}" for name, plane in self._planes.items())
        return f"Frame({shapes})"

    def srgb(self, exposure_ev: float = 0.0, background: float | None = None) -> Plane:
        """The colour as a display shows it, 0 to 1, height x width x 4 with straight alpha, or x 3 over a grey `background`."""
        alpha = self["alpha"][..., None]
        linear = self["rgb"] / np.maximum(alpha, 1e-6) * np.float32(2.0**exposure_ev)
        linear = np.clip(linear, 0.0, 1.0)
        shown = np.where(linear <= 0.0031308, 12.92 * linear, 1.055 * np.power(linear, 1 / 2.4) - 0.055)
        shown = shown.astype(np.float32)
        if background is None:
            return np.concatenate([shown, alpha], axis=-1)
        over = shown * alpha + np.float32(background) * (1 - alpha)
        return over.astype(np.float32)

    @classmethod
    def from_exr(cls, data: bytes) -> Frame:
        """The frame in an EXR file that a server made."""
        channels: dict[str, Plane] = {}
        # The library reads files by name alone.
        handle, name = tempfile.mkstemp(suffix=".exr")
        try:
            with os.fdopen(handle, "wb") as file:
                file.write(data)
            with OpenEXR.File(name, separate_channels=True) as exr:
                for part in exr.parts:
                    for channel, values in part.channels.items():
                        channels[channel] = np.asarray(values.pixels, dtype=np.float32)
        finally:
            Path(name).unlink(missing_ok=True)
        planes = {}
        for output, names in _CHANNELS.items():
            if all(name in channels for name in names):
                found = [channels[name] for name in names]
                planes[output] = found[0] if len(found) == 1 else np.stack(found, axis=-1)
        if "depth" in planes:
            # Files have 0 where nothing is.
            depth = planes["depth"]
            planes["depth"] = np.where(depth > 0, depth, np.float32(np.inf)).astype(np.float32)
        alpha = channels.get("A", channels.get("alpha.Y"))
        if alpha is not None:
            planes["alpha"] = alpha
        return cls(planes)
