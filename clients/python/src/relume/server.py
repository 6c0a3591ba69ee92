"""The program `relume` of this machine, and servers that live as long as a Python process needs them."""

from __future__ import annotations

import os
import shutil
import subprocess
import sys
import sysconfig
import tempfile
from pathlib import Path
from types import TracebackType

from relume.client import Client
from relume.errors import Unreachable

# Seconds that a server may take to end its work after it was asked to.
_END = 30.0
_LISTENING = "listening on "


def program() -> Path:
    """Path of the program `relume`: that of the installed package, else the first on PATH. Raises FileNotFoundError if there is none."""
    name = "relume.exe" if sys.platform == "win32" else "relume"
    folders = [sysconfig.get_path("scripts"), sysconfig.get_path("scripts", f"{os.name}_user")]
    for folder in folders:
        if (path := Path(folder) / name).is_file():
            return path
    if found := shutil.which(name):
        return Path(found)
    raise FileNotFoundError(f"the program {name} is neither in {folders[0]} nor on PATH; install it with: pip install relume")


class Server:
    """A server on a free port of this machine, without keys.

    It stops when the `with` block ends or `stop` is called. `data` is its data directory; omitted: a temporary folder, which is deleted at the end.
    `options` are further options of `relume serve`. Raises FileNotFoundError without the program, and Unreachable if the server does not start.

    >>> with relume.Server() as server:                             # doctest: +SKIP
    ...     model = server.client.upload_capture("photos").train("draft").wait()
    """

    def __init__(self, data: str | os.PathLike[str] | None = None, *, options: tuple[str, ...] = ()) -> None:
        self._temporary = tempfile.TemporaryDirectory(prefix="relume-") if data is None else None
        folder = self._temporary.name if self._temporary else os.fspath(data or "")
        arguments = ["serve", "--listen", "127.0.0.1:0", "--data-dir", folder, *options]
        self._process = subprocess.Popen([program(), *arguments], stdout=subprocess.PIPE, text=True)
        assert self._process.stdout is not None
        line = self._process.stdout.readline()
        if not line.startswith(_LISTENING):
            self.stop()
            raise Unreachable("the server did not start; its messages are above")
        self.url = line.removeprefix(_LISTENING).strip()
        self.client = Client(self.url)

    def __enter__(self) -> Server:
        return self

    def __exit__(self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None) -> None:
        self.stop()

    def stop(self) -> None:
        """Stops the server. A training that runs ends at its next checkpoint."""
        if hasattr(self, "client"):
            self.client.close()
        if self._process.poll() is None:
            self._process.terminate()
            try:
                self._process.wait(_END)
            except subprocess.TimeoutExpired:
                self._process.kill()
                self._process.wait()
        if self._process.stdout is not None:
            self._process.stdout.close()
        if self._temporary is not None:
            self._temporary.cleanup()
