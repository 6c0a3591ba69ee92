"""Client of Relume: photographs become relightable 3D models, and frames under any light.

>>> import relume
>>> client = relume.Client("http://127.0.0.1:7878")               # doctest: +SKIP
>>> job = client.upload_capture("capture.zip").train("draft")     # doctest: +SKIP
>>> model = job.wait()                                            # doctest: +SKIP
>>> frame = model.render(relume.orbit(30, 20), environment="sunset")   # doctest: +SKIP
>>> frame["rgb"].shape                                            # doctest: +SKIP
(512, 512, 3)
"""

from relume import light_matrix
from relume.cameras import Camera, look_at, matrix, orbit
from relume.client import Client
from relume.errors import ExportFailed, JobFailed, RelumeError, Unreachable
from relume.frames import Frame
from relume.resources import Capture, Environment, Export, Job, Light, Model
from relume.server import Server, program

__all__ = [
    "Camera",
    "Capture",
    "Client",
    "Environment",
    "Export",
    "ExportFailed",
    "Frame",
    "Job",
    "JobFailed",
    "Light",
    "Model",
    "RelumeError",
    "Server",
    "Unreachable",
    "light_matrix",
    "look_at",
    "matrix",
    "orbit",
    "program",
]
