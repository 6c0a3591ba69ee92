#!/usr/bin/env python3
"""A complete pipeline with Relume: uploads a capture, trains a model, renders relit EXR frames and deletes everything on the server.

    relume sample capture.zip
    RELUME_API_KEY=... python3 relight.py capture.zip frames/ --env sunset --gate 'novel_view.psnr>=20'

It needs Python 3.9 and no other package. Exit status: 0 if the frames exist, 2 if the model missed the quality gate, and 1 if something
failed or a signal stopped the script. In each case the script deletes what it created on the server.
"""

import argparse
import json
import math
import os
import re
import sys
import tempfile
import uuid
from pathlib import Path

from made import Made
from relume_http import BROKEN, Server, Trouble, begin_upload, send_pieces, sha256_of
from webhook import Receiver

ENDS = ["job.succeeded", "job.rejected", "job.failed", "job.cancelled"]
EXR_MAGIC = bytes([0x76, 0x2F, 0x31, 0x01])
# The first bytes of each format of light files that the server accepts.
LIGHT_FILES = {".hdr": b"#?", ".exr": EXR_MAGIC}


class Rejected(Exception):
    """The model missed the quality gate."""


class Parser(argparse.ArgumentParser):
    def error(self, message):
        """Exits with 1, because argparse's default of 2 means a missed gate here."""
        self.print_usage(sys.stderr)
        self.exit(1, f"failed: {message}\n")


def count(text):
    """Parses an integer of at least 1."""
    number = int(text)
    if number < 1:
        raise argparse.ArgumentTypeError(f"{text} is less than 1")
    return number


def mib(text):
    """Converts MiB to bytes; at least one byte."""
    size = float(text) * 2**20
    if not math.isfinite(size) or size < 1:
        raise argparse.ArgumentTypeError(f"{text} MiB is not a valid chunk size")
    return int(size)


def setting(text):
    """Parses NAME=VALUE. A value that is not JSON is a string."""
    name, equals, value = text.partition("=")
    if not name or not equals:
        raise argparse.ArgumentTypeError(f"{text}: expected NAME=VALUE, e.g. iterations=300")
    try:
        return name, json.loads(value)
    except ValueError:
        return name, value


def bound(text):
    """Parses a figure and its bound, e.g. novel_view.psnr and >=28."""
    figure = re.fullmatch(r"([a-z_.]+)\s*([<>]=?.+)", text)
    if not figure:
        raise argparse.ArgumentTypeError(f"{text}: expected a figure and a bound, e.g. novel_view.psnr>=28")
    return figure[1], figure[2]


def arguments():
    parse = Parser(description="Relight a capture with a Relume server.")
    parse.add_argument("capture", type=Path, help="archive with photographs and cameras")
    parse.add_argument("out", type=Path, help="folder for the frames")
    parse.add_argument("--url", default=os.environ.get("RELUME_URL", "http://127.0.0.1:7878"), help="URL of the server")
    parse.add_argument("--listen", default="127.0.0.1:0", metavar="HOST:PORT", help="address of the webhook receiver")
    parse.add_argument("--hook-url", help="URL at which the server reaches the receiver; default: http://HOST:PORT/")
    parse.add_argument("--name", default="pipeline-example", help="name of the job")
    parse.add_argument("--preset", default="draft", choices=["draft", "standard", "high"])
    settings = {"type": setting, "action": "append", "default": [], "metavar": "NAME=VALUE"}
    parse.add_argument("--set", **settings, help="training setting, e.g. iterations=300; a value that is not JSON is a string")
    parse.add_argument("--gate", type=bound, action="append", default=[], metavar="BOUND", help="quality gate, e.g. novel_view.psnr>=28")
    parse.add_argument("--env", default="sunset", help="built-in light, or a .hdr or .exr file")
    parse.add_argument("--frames", type=count, default=8, help="number of frames in one turn around the object")
    parse.add_argument("--size", type=count, default=512, help="width and height of a frame, pixels")
    parse.add_argument("--eye", type=float, nargs=3, default=[3.0, 0.0, 1.5], help="position of the first camera, capture units")
    parse.add_argument("--piece-mib", type=mib, default="16", dest="piece_bytes", metavar="MIB", help="size of an upload chunk, MiB")
    parse.add_argument("--patience", type=float, default=24 * 3600, help="seconds to wait for the end of the job")
    return parse.parse_args()


def check_files(options):
    """Checks before the upload that the capture and the light file are readable and that the output folder is writable."""
    with options.capture.open("rb"):
        pass
    begin = LIGHT_FILES.get(Path(options.env).suffix.lower())
    if begin:
        with open(options.env, "rb") as file:
            if file.read(len(begin)) != begin:
                raise Trouble(f"--env {options.env}: the file does not begin with the signature of its format")
    options.out.mkdir(parents=True, exist_ok=True)
    with tempfile.TemporaryFile(dir=options.out):
        pass


def check_builtin(server, name):
    """Checks that the server has the built-in light `name`; does nothing for a file."""
    if Path(name).suffix.lower() in LIGHT_FILES:
        return
    builtin = server.json("GET", "/v1/environments")["builtin"]
    if name not in builtin:
        raise Trouble(f"--env {name}: neither a .hdr or .exr file nor one of {', '.join(builtin)}")


def make_capture(server, made, path, piece_bytes):
    """Uploads the archive at `path`, creates its capture and waits until the server has validated it."""
    with made.noting() as note:
        where = begin_upload(server, path)
        note(where)
    send_pieces(server, where, path, piece_bytes)
    sent = {"upload": where.rsplit("/", 1)[1]}
    with made.noting() as note:
        capture = server.json("POST", "/v1/captures", sent, headers={"Prefer": "respond-async"})
        note(f"/v1/captures/{capture['id']}")
    capture = server.poll(f"/v1/captures/{capture['id']}", lambda c: c["state"] != "validating")
    if capture["state"] == "invalid":
        raise Trouble(f"{path} is no capture: {capture['problem']['detail']}")
    if capture["sha256"] != sha256_of(path):
        raise Trouble("the hash of the capture differs from the hash of the file")
    print(f"capture {capture['id']}: {capture['report']['train_images']} photographs")
    return capture


def new_job(options, capture):
    """The job request, with the training settings and the quality gate."""
    return {
        "capture": capture["id"],
        "name": options.name,
        "labels": {"made-by": "pipeline-example"},
        "preset": options.preset,
        "overrides": dict(options.set),
        "quality_gate": dict(options.gate),
    }


def print_progress(server, job):
    """Prints how far the job is. The server may be away for a while; the webhook arrives when it is back."""
    try:
        now = server.json("GET", f"/v1/jobs/{job}")
    except (Trouble, *BROKEN) as trouble:
        print(f"no progress known: {trouble}")
        return
    progress = now.get("progress") or {}
    if not progress.get("total"):
        print(now["state"])
        return
    left = progress.get("eta_seconds")
    print(f"{now['state']}: step {progress['step']} of {progress['total']}" + (f", {left:.0f} s left" if left is not None else ""))


def wait_for_end(server, receiver, job, patience):
    """Returns the job from its webhook, or from the server if no message arrives within `patience` seconds. Raises unless the job succeeded."""
    told = receiver.wait_for(job["id"], patience, lambda: print_progress(server, job["id"]))
    print(f"a webhook says {told['type']}" if told else "no webhook arrived in time")
    ended = told["data"]["job"] if told else server.json("GET", f"/v1/jobs/{job['id']}")
    if ended["state"] == "rejected":
        missed = [f"{m['figure']} is {m.get('found')}, not {m['wanted']}" for m in ended["missed"]]
        raise Rejected("; ".join(missed))
    if ended["state"] != "succeeded":
        raise Trouble(f"the job has the state {ended['state']}: {ended.get('error')}")
    print(f"model {ended['model']}: {json.dumps(ended['figures']['novel_view'])}")
    return ended


def light(server, made, name):
    """The environment of a render request: a built-in map, or a file that this function uploads."""
    suffix = Path(name).suffix.lower()
    if suffix not in LIGHT_FILES:
        return {"builtin": name}
    media_type = "image/vnd.radiance" if suffix == ".hdr" else "image/x-exr"
    with made.noting() as note:
        answer = server.ask("POST", "/v1/environments", Path(name).read_bytes(), {"Content-Type": media_type})
        environment = json.loads(answer.body)
        note(f"/v1/environments/{environment['id']}")
    return {"id": environment["id"]}


def render_turn(server, model, environment, options):
    """Renders one EXR per frame with the relit picture, normals and depth. The camera makes one turn around the object."""
    x, y, z = options.eye
    for frame in range(options.frames):
        turn = 2 * math.pi * frame / options.frames
        eye = [x * math.cos(turn) - y * math.sin(turn), x * math.sin(turn) + y * math.cos(turn), z]
        request = {
            "camera": {"look_at": {"eye": eye, "target": [0, 0, 0], "fov_y_deg": 40}},
            "environment": environment,
            "width": options.size,
            "height": options.size,
            "outputs": ["rgb", "alpha", "normal", "depth"],
        }
        body = json.dumps(request).encode()
        headers = {"Content-Type": "application/json", "Accept": "image/x-exr"}
        answer = server.ask("POST", f"/v1/models/{model}/render", body, headers)
        if answer.body[:4] != EXR_MAGIC:
            raise Trouble(f"the response for frame {frame} is not an EXR file")
        path = options.out / f"relit.{frame + 1:04}.exr"
        # Write under another name and rename, so that the folder never has an incomplete frame.
        part = path.with_suffix(".part")
        part.write_bytes(answer.body)
        part.replace(path)
        print(f"wrote {path}")


def go_round(server, made, run, options):
    """Runs all steps except the deletion. The job and its model get the external id `run`, by which delete_all finds them."""
    with Receiver(options.listen) as receiver:
        with made.noting() as note:
            hook = server.json("POST", "/v1/webhooks", {"url": options.hook_url or receiver.url, "events": ENDS})
            note(f"/v1/webhooks/{hook['id']}")
        receiver.secret = hook["secret"]
        check_builtin(server, options.env)
        capture = make_capture(server, made, options.capture, options.piece_bytes)
        # With this key a repeated request, after a lost response, creates no second job.
        once = {"Idempotency-Key": run}
        with made.noting() as note:
            # Set this before the request, because its response may be lost.
            made.asked_for_job = True
            job = server.json("POST", "/v1/jobs", {**new_job(options, capture), "external_id": run}, headers=once)
            note(f"/v1/jobs/{job['id']}?cascade=true")
        print(f"job {job['id']}")
        ended = wait_for_end(server, receiver, job, options.patience)
    render_turn(server, ended["model"], light(server, made, options.env), options)


def delete_all(server, made, run):
    made.delete(server)
    if not made.asked_for_job:
        return
    # Delete models after the job: a deleted job creates no more models.
    try:
        for model in server.json("GET", f"/v1/models?external_id={run}")["items"]:
            server.delete(f"/v1/models/{model['id']}")
    except (Trouble, *BROKEN) as trouble:
        print(f"not deleted: models with the external id {run}: {trouble}")


def main():
    options = arguments()
    server = Server(options.url, os.environ.get("RELUME_API_KEY") or os.environ.get("RELUME_KEY"))
    made, run = Made(), str(uuid.uuid4())
    try:
        check_files(options)
        try:
            go_round(server, made, run, options)
        finally:
            delete_all(server, made, run)
    except Rejected as missed:
        print(f"rejected: {missed}", file=sys.stderr)
        return 2
    except (Trouble, *BROKEN, ValueError) as trouble:
        print(f"failed: {trouble}", file=sys.stderr)
        return 1
    return 0


if __name__ == "__main__":
    sys.exit(main())
