"""A server."""

from __future__ import annotations

import os
from collections.abc import Iterator
from pathlib import Path
from types import TracebackType
from typing import Any

import httpx

from relume.http import Connection
from relume.resources import Capture, Environment, Job, Model
from relume.uploads import archive_of, upload


class Client:
    """A Relume server.

    `key` is an API key where the server wants one; omitted: the environment variable RELUME_API_KEY, or RELUME_KEY (deprecated). `timeout` bounds how long an
    answer may take, seconds. Methods raise RelumeError for what the server refuses and Unreachable when it does not answer.
    """

    def __init__(
        self,
        url: str = "http://127.0.0.1:7878",
        key: str | None = None,
        *,
        timeout: float = 600.0,
        transport: httpx.BaseTransport | None = None,
    ) -> None:
        self._connection = Connection(url, key or os.environ.get("RELUME_API_KEY") or os.environ.get("RELUME_KEY"), timeout, transport)

    def __enter__(self) -> Client:
        return self

    def __exit__(self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None) -> None:
        self.close()

    def close(self) -> None:
        """Closes the connections."""
        self._connection.close()

    def upload_capture(self, path: str | os.PathLike[str], *, name: str | None = None, progress: bool = False) -> Capture:
        """Uploads photographs with their cameras: a zip, tar or tar.gz, or a folder. A broken connection is gone on with.

        Photographs without cameras are taken where the server finds these; `wait()` on the capture until it has.
        """
        with archive_of(Path(path)) as (file, length, filename):
            identifier = upload(self._connection, file, length, filename, progress)
        named = {"name": name} if name is not None else {}
        made = self._connection.json("POST", "/v1/captures", json={"upload": identifier}, params=named)
        return Capture(self._connection, made)

    def upload_environment(self, path: str | os.PathLike[str], *, name: str | None = None) -> Environment:
        """Uploads an environment map, `.hdr` or `.exr`, equirectangular."""
        named = {"name": name} if name is not None else {}
        headers = {"Content-Type": "application/octet-stream"}
        content = Path(path).read_bytes()
        made = self._connection.json("POST", "/v1/environments", content=content, headers=headers, params=named)
        return Environment(self._connection, made)

    def capture(self, identifier: str) -> Capture:
        """A capture by its identifier."""
        return Capture(self._connection, self._connection.json("GET", f"/v1/captures/{identifier}"))

    def job(self, identifier: str) -> Job:
        """A job by its identifier."""
        return Job(self._connection, self._connection.json("GET", f"/v1/jobs/{identifier}"))

    def model(self, identifier: str) -> Model:
        """A model by its identifier."""
        return Model(self._connection, self._connection.json("GET", f"/v1/models/{identifier}"))

    def captures(self, **filters: str) -> Iterator[Capture]:
        """Captures, newest first. `filters` are parameters of the list: `name`, `label`, `external_id`."""
        return (Capture(self._connection, item) for item in self._all("/v1/captures", filters))

    def environments(self, **filters: str) -> Iterator[Environment]:
        """Uploaded environment maps, newest first."""
        return (Environment(self._connection, item) for item in self._all("/v1/environments", filters))

    def jobs(self, **filters: str) -> Iterator[Job]:
        """Jobs, newest first. `filters` are parameters of the list: `state`, `label`, `external_id`."""
        return (Job(self._connection, item) for item in self._all("/v1/jobs", filters))

    def models(self, **filters: str) -> Iterator[Model]:
        """Models, newest first."""
        return (Model(self._connection, item) for item in self._all("/v1/models", filters))

    def usage(self) -> dict[str, Any]:
        """What is stored, in bytes and pieces."""
        usage: dict[str, Any] = self._connection.json("GET", "/v1/usage")
        return usage

    def _all(self, path: str, filters: dict[str, str]) -> Iterator[dict[str, Any]]:
        """Every item of a list, page by page."""
        parameters = dict(filters)
        while True:
            page = self._connection.json("GET", path, params=parameters)
            yield from page["items"]
            if not page.get("next"):
                return
            parameters["before"] = page["next"]
