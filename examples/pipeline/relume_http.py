"""Requests to a Relume server, and uploads that go on where they broke off."""

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
# What a broken connection raises, at whatever moment it breaks.
BROKEN = (OSError, http.client.HTTPException)
BUSY = (429, 503)
# As well: the piece of a broken connection is still being written.
WAITING = (423, *BUSY)
TRIES = 20
# How often in a row a piece may be sent in vain to a server that answers.
IN_VAIN = 3
TUS = {"Tus-Resumable": "1.0.0"}


class Trouble(Exception):
    """What went wrong, in a sentence; `status` where a server said it."""

    def __init__(self, sentence, status=None):
        super().__init__(sentence)
        self.status = status


class Server:
    def __init__(self, url, key=None, timeout=600):
        self.url, self.key, self.timeout = url, key, timeout

    def once(self, method, path, body=None, headers=None):
        """One request. A refusal is a `Trouble` with what the server says of it; a broken connection is one of `BROKEN`."""
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
        """A request that is made again while the server is busy, for as long as it asks to wait."""
        for attempt in range(TRIES):
            try:
                return self.once(method, path, body, headers)
            except Trouble as trouble:
                if trouble.status not in BUSY or attempt + 1 == TRIES:
                    raise
                time.sleep(trouble.retry_after)

    def json(self, method, path, body=None, headers=None):
        """A request with JSON both ways."""
        sent = None if body is None else json.dumps(body).encode()
        headers = {"Content-Type": "application/json", **(headers or {})}
        return json.loads(self.ask(method, path, sent, headers).body)

    def poll(self, path, is_done, every=0.5):
        """What is at `path`, as soon as it is as wished."""
        while True:
            thing = self.json("GET", path)
            if is_done(thing):
                return thing
            time.sleep(every)

    def delete(self, path):
        """Deletes what is at `path`, which may be gone already; an upload wants the header of its protocol."""
        try:
            self.ask("DELETE", path, headers=TUS)
        except Trouble as trouble:
            if trouble.status not in (404, 410):
                print(f"not deleted: {trouble}")
        except BROKEN as broken:
            print(f"not deleted: {path}: {broken}")


def begin_upload(server, path):
    """Where the pieces of a file go, by tus 1.0.0."""
    name = base64.b64encode(path.name.encode()).decode()
    headers = {**TUS, "Upload-Length": str(path.stat().st_size), "Upload-Metadata": f"filename {name}"}
    return server.ask("POST", "/v1/uploads", headers=headers).headers["Location"]


def send_pieces(server, where, path, piece_bytes):
    """Sends a file to `where` and goes on after a break. Each piece is kept whole or not at all."""
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
                print(f"the upload broke off and goes on at byte {offset} of {size}")


def where_to_go_on(server, where, trouble, troubles):
    """How much of an upload the server has, after `troubles` troubles in a row."""
    # Busy, an offset that moved on, or a piece that was changed on its way.
    passing = getattr(trouble, "status", None) in (None, 409, 460, *WAITING)
    if not passing or troubles > TRIES:
        raise trouble
    time.sleep(min(0.1 * 2**troubles, 30))
    try:
        return int(server.ask("HEAD", where, headers=TUS).headers["Upload-Offset"])
    except BROKEN as broken:
        return where_to_go_on(server, where, broken, troubles + 1)


def sha256_of(path):
    """The hash of a file, in hex, without holding it in memory."""
    digest = hashlib.sha256()
    with path.open("rb") as file:
        while block := file.read(2**20):
            digest.update(block)
    return digest.hexdigest()
