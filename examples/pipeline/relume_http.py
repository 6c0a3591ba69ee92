"""Requests to a Relume server, and resumable uploads."""

import base64
import hashlib
import http.client
import json
import time
import urllib.error
import urllib.request
from collections import namedtuple
from urllib.parse import urljoin

Answer = namedtuple("Answer", "status headers body")
# The exceptions that a broken connection raises.
BROKEN = (OSError, http.client.HTTPException)
BUSY = (429, 503)
# 423: the server is still writing the chunk of a broken connection.
WAITING = (423, *BUSY)
TRIES = 20
# How many times in a row the server may store nothing of a chunk although it responds.
IN_VAIN = 3
TUS = {"Tus-Resumable": "1.0.0"}


class Trouble(Exception):
    """An error with a message; `status` is the HTTP status if the server reported the error."""

    def __init__(self, sentence, status=None):
        super().__init__(sentence)
        self.status = status


class Server:
    def __init__(self, url, key=None, timeout=600):
        self.url, self.key, self.timeout = url, key, timeout

    def once(self, method, path, body=None, headers=None):
        """Sends one request. An error status raises `Trouble` with the server's message; a broken connection raises one of `BROKEN`."""
        headers = {"Content-Type": "application/octet-stream", **(headers or {})}
        if self.key:
            headers["Authorization"] = f"Bearer {self.key}"
        request = urllib.request.Request(urljoin(self.url, path), body, headers, method=method)
        try:
            with urllib.request.urlopen(request, timeout=self.timeout) as answer:
                return Answer(answer.status, answer.headers, answer.read())
        except urllib.error.HTTPError as refusal:
            with refusal:
                said = refusal.read().decode("utf-8", "replace")
            trouble = Trouble(f"{method} {path}: {refusal.code} {said}", refusal.code)
            trouble.retry_after = float(refusal.headers.get("Retry-After") or 1)
            raise trouble from None

    def ask(self, method, path, body=None, headers=None):
        """Sends a request and repeats it while the server is busy, up to `TRIES` times, after the delay in Retry-After."""
        for attempt in range(TRIES):
            try:
                return self.once(method, path, body, headers)
            except Trouble as trouble:
                if trouble.status not in BUSY or attempt + 1 == TRIES:
                    raise
                time.sleep(trouble.retry_after)

    def json(self, method, path, body=None, headers=None):
        """Sends a JSON request and returns the JSON response."""
        sent = None if body is None else json.dumps(body).encode()
        headers = {"Content-Type": "application/json", **(headers or {})}
        return json.loads(self.ask(method, path, sent, headers).body)

    def poll(self, path, is_done, every=0.5):
        """Requests `path` every `every` seconds until `is_done` accepts the response, and returns it."""
        while True:
            thing = self.json("GET", path)
            if is_done(thing):
                return thing
            time.sleep(every)

    def delete(self, path):
        """Deletes `path`; it may already be deleted. The deletion of an upload needs the tus header."""
        try:
            self.ask("DELETE", path, headers=TUS)
        except Trouble as trouble:
            if trouble.status not in (404, 410):
                print(f"not deleted: {trouble}")
        except BROKEN as broken:
            print(f"not deleted: {path}: {broken}")


def begin_upload(server, path):
    """Creates a tus 1.0.0 upload and returns its location."""
    name = base64.b64encode(path.name.encode()).decode()
    headers = {**TUS, "Upload-Length": str(path.stat().st_size), "Upload-Metadata": f"filename {name}"}
    return server.ask("POST", "/v1/uploads", headers=headers).headers["Location"]


def send_pieces(server, where, path, piece_bytes):
    """Sends a file to `where` in chunks and resumes after a broken connection. The server stores each chunk completely or not at all."""
    size, offset, troubles, in_vain = path.stat().st_size, 0, 0, 0
    with path.open("rb") as file:
        while offset < size:
            file.seek(offset)
            piece = file.read(min(piece_bytes, size - offset))
            checksum = base64.b64encode(hashlib.sha256(piece).digest()).decode()
            headers = {
                **TUS,
                "Content-Type": "application/offset+octet-stream",
                "Upload-Offset": str(offset),
                "Upload-Checksum": f"sha256 {checksum}",
            }
            try:
                offset = int(server.once("PATCH", where, piece, headers).headers["Upload-Offset"])
                troubles = in_vain = 0
            except (Trouble, *BROKEN) as trouble:
                troubles += 1
                before, offset = offset, where_to_go_on(server, where, trouble, troubles)
                if offset != before:
                    troubles = in_vain = 0
                elif getattr(trouble, "status", None) not in WAITING:
                    in_vain += 1
                    if in_vain == IN_VAIN:
                        raise
                print(f"the connection broke; the upload goes on at byte {offset} of {size}")


def where_to_go_on(server, where, trouble, troubles):
    """The number of bytes that the server has stored, after `troubles` errors in a row. Raises `trouble` if a retry cannot help."""
    # Temporary errors: a broken connection, a busy server, another offset (409), or a wrong checksum (460).
    passing = getattr(trouble, "status", None) in (None, 409, 460, *WAITING)
    if not passing or troubles > TRIES:
        raise trouble
    time.sleep(min(0.1 * 2**troubles, 30))
    try:
        return int(server.ask("HEAD", where, headers=TUS).headers["Upload-Offset"])
    except BROKEN as broken:
        return where_to_go_on(server, where, broken, troubles + 1)


def sha256_of(path):
    """The SHA-256 of a file in hex. Reads the file in blocks of 1 MiB."""
    digest = hashlib.sha256()
    with path.open("rb") as file:
        while block := file.read(2**20):
            digest.update(block)
    return digest.hexdigest()
