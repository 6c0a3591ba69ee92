"""Uploads in pieces by tus 1.0, which go on where a connection broke."""

from __future__ import annotations

import base64
import hashlib
import os
import tempfile
import time
import zipfile
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import BinaryIO

from tqdm import tqdm

from relume.errors import RelumeError, Unreachable
from relume.http import Connection

_TUS = {"Tus-Resumable": "1.0.0"}
_PIECE = 16 << 20
# Pieces that may fail one after the other.
_PATIENCE = 8


def upload(connection: Connection, file: BinaryIO, length: int, filename: str, progress: bool) -> str:
    """Sends a file of `length` bytes and gives the identifier of the complete upload. Raises RelumeError and Unreachable."""
    name = base64.b64encode(filename.encode()).decode()
    headers = {**_TUS, "Upload-Length": str(length), "Upload-Metadata": f"filename {name}"}
    path = connection.send("POST", "/v1/uploads", headers=headers, again=False).headers["location"]
    offset = failed = 0
    with tqdm(total=length, unit="B", unit_scale=True, desc=filename, disable=not progress) as bar:
        while offset < length:
            file.seek(offset)
            piece = file.read(_PIECE)
            try:
                offset = _send(connection, path, offset, piece)
                failed = 0
            except (Unreachable, RelumeError) as error:
                failed += 1
                # A client's fault stays one; 409 is another opinion about the offset, 460 a piece that was damaged on the way.
                is_final = isinstance(error, RelumeError) and error.status < 500 and error.status not in (409, 423, 460)
                if is_final or failed > _PATIENCE:
                    raise
                time.sleep(min(0.25 * 2**failed, 15.0))
                offset = int(connection.send("HEAD", path, headers=_TUS).headers["upload-offset"])
            # A bar that is not shown does not count.
            bar.update(offset - bar.n)
    return path.rsplit("/", 1)[-1]


def _send(connection: Connection, path: str, offset: int, piece: bytes) -> int:
    digest = base64.b64encode(hashlib.sha256(piece).digest()).decode()
    headers = {
        **_TUS,
        "Upload-Offset": str(offset),
        "Upload-Checksum": f"sha256 {digest}",
        "Content-Type": "application/offset+octet-stream",
    }
    answer = connection.send("PATCH", path, headers=headers, content=piece, again=False)
    return int(answer.headers["upload-offset"])


@contextmanager
def archive_of(path: Path) -> Iterator[tuple[BinaryIO, int, str]]:
    """A file as it is, or a folder as a zip, with its length and its name. Raises OSError."""
    if not path.is_dir():
        with path.open("rb") as file:
            yield file, path.stat().st_size, path.name
        return
    files = sorted(p for p in path.rglob("*") if p.is_file())
    if not files:
        raise FileNotFoundError(f"{path} has no files")
    with tempfile.TemporaryFile(suffix=".zip") as out:
        # Photographs are compressed already.
        with zipfile.ZipFile(out, "w", zipfile.ZIP_STORED, allowZip64=True, strict_timestamps=False) as archive:
            for file_path in files:
                archive.write(file_path, file_path.relative_to(path).as_posix())
        length = out.seek(0, os.SEEK_END)
        out.seek(0)
        yield out, length, f"{path.resolve().name}.zip"
