"""Requests that wait while the server is busy, and errors in the server's words."""

from __future__ import annotations

import time
from typing import Any, BinaryIO

import httpx

from relume.errors import RelumeError, Unreachable

# Seconds between attempts where the server does not say.
_GAPS = (0.5, 1.0, 2.0, 4.0, 8.0, 15.0)


class Connection:
    """A server, and the key that it wants."""

    def __init__(self, url: str, key: str | None, timeout: float, transport: httpx.BaseTransport | None) -> None:
        headers = {"Authorization": f"Bearer {key}"} if key else {}
        # A render may wait for a training, an upload for its validation.
        limits = httpx.Timeout(timeout, connect=10.0)
        self._http = httpx.Client(base_url=url.rstrip("/"), headers=headers, timeout=limits, transport=transport)

    def close(self) -> None:
        """Closes the connections."""
        self._http.close()

    def send(self, method: str, path: str, *, again: bool = True, **request: Any) -> httpx.Response:
        """The answer to a request.

        While the server says that it is busy (429, 503), it is asked again when it wants to be; after a broken connection only where
        `again` says that nothing can happen twice. Raises RelumeError and Unreachable.
        """
        for gap in (*_GAPS, None):
            try:
                answer = self._http.request(method, path, **request)
            except httpx.TransportError as error:
                if gap is None or not again:
                    raise Unreachable(f"{method} {path}: {error}") from error
                time.sleep(gap)
                continue
            if answer.status_code not in (429, 503) or gap is None:
                return checked(answer)
            time.sleep(_wanted_gap(answer, gap))
        raise AssertionError("the last attempt returns")

    def json(self, method: str, path: str, **request: Any) -> Any:
        """The JSON of an answer."""
        return self.send(method, path, **request).json()

    def save(self, path: str, file: BinaryIO) -> None:
        """Writes an answer's body to a file as it comes. Raises RelumeError and Unreachable."""
        try:
            # An object store may have it; httpx tells nobody else the key.
            with self._http.stream("GET", path, follow_redirects=True) as answer:
                if not answer.is_success:
                    answer.read()
                    checked(answer)
                for piece in answer.iter_bytes():
                    file.write(piece)
        except httpx.TransportError as error:
            raise Unreachable(f"GET {path}: {error}") from error


def checked(answer: httpx.Response) -> httpx.Response:
    """The answer, unless it is an error. Raises RelumeError."""
    if answer.is_success or answer.status_code == 304:
        return answer
    try:
        problem = answer.json()
    except ValueError:
        problem = {"title": answer.reason_phrase, "detail": answer.text[:200]}
    raise RelumeError(answer.status_code, problem if isinstance(problem, dict) else {})


def _wanted_gap(answer: httpx.Response, gap: float) -> float:
    try:
        return min(60.0, max(0.0, float(answer.headers["retry-after"])))
    except (KeyError, ValueError):
        return gap
