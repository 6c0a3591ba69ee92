#!/usr/bin/env python3
"""A capture in, relit EXR frames out, nothing left on the server: a pipeline's whole round with Relume.

    relume sample capture.zip
    RELUME_KEY=... python3 relight.py capture.zip frames/ --env sunset --gate 'novel_view.psnr>=20'

Python 3.9 and its standard library. Ends with 0 when the frames are there, 2 when the model missed the quality gate, and 1
when something failed or it was stopped; what it made on the server is deleted in each case.
"""

import argparse
import json
import math
import os
import re
import sys
import uuid
from pathlib import Path

from made import Made
from relume_http import BROKEN, Server, Trouble, begin_upload, send_pieces, sha256_of
from webhook import Receiver

ENDS = ["job.succeeded", "job.rejected", "job.failed", "job.cancelled"]
EXR_MAGIC = bytes([0x76, 0x2F, 0x31, 0x01])


class Rejected(Exception):
    """The model is not as good as the quality gate asks for."""


def arguments():
    parse = argparse.ArgumentParser(description="Relight a capture with a Relume server.")
    parse.add_argument("capture", type=Path, help="the archive of photographs and cameras")
    parse.add_argument("out", type=Path, help="folder for the frames")
    parse.add_argument("--url", default=os.environ.get("RELUME_URL", "http://127.0.0.1:7878"), help="the server")
    parse.add_argument("--listen", default="127.0.0.1:0", metavar="HOST:PORT", help="where webhooks are received")
    parse.add_argument("--hook-url", help="by which URL the server reaches that; http://HOST:PORT/ where absent")
    parse.add_argument("--name", default="pipeline-example", help="what the job is called")
    parse.add_argument("--preset", default="draft", choices=["draft", "standard", "high"])
    parse.add_argument("--set", action="append", default=[], metavar="NAME=JSON", help="a training setting, as iterations=300")
    parse.add_argument("--gate", action="append", default=[], metavar="BOUND", help="as novel_view.psnr>=28")
    parse.add_argument("--env", default="sunset", help="a built-in light, or a .hdr or .exr file")
    parse.add_argument("--frames", type=int, default=8, help="frames of one turn around the thing")
    parse.add_argument("--size", type=int, default=512, help="pixels a side")
    parse.add_argument("--eye", type=float, nargs=3, default=[3.0, 0.0, 1.5], help="where the first camera stands")
    parse.add_argument("--piece-mib", type=float, default=16, help="MiB that are sent at once")
    parse.add_argument("--patience", type=float, default=24 * 3600, help="seconds to wait for the end of the job")
    return parse.parse_args()


def make_capture(server, made, path, piece_bytes):
    """The capture of the archive at `path`, when it is validated."""
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
        raise Trouble("what arrived is not what was sent")
    print(f"capture {capture['id']}: {capture['report']['train_images']} photographs")
    return capture


def new_job(options, capture):
    """What to train, and what the model has to reach."""
    gate = {}
    for bound in options.gate:
        figure = re.fullmatch(r"([a-z_.]+)\s*([<>]=?.+)", bound)
        if not figure:
            raise Trouble(f"--gate {bound}: a figure and a bound are needed, as novel_view.psnr>=28")
        gate[figure[1]] = figure[2]
    overrides = {}
    for setting in options.set:
        name, _, value = setting.partition("=")
        overrides[name] = json.loads(value)
    return {
        "capture": capture["id"],
        "name": options.name,
        "labels": {"made-by": "pipeline-example"},
        "preset": options.preset,
        "overrides": overrides,
        "quality_gate": gate,
    }


def wait_for_end(server, receiver, job, patience):
    """The job as its webhook tells it; the server is asked as well when no message comes."""
    told = receiver.wait_for(job["id"], patience)
    print(f"a webhook says {told['type']}" if told else "no webhook came in time")
    ended = told["data"]["job"] if told else server.json("GET", f"/v1/jobs/{job['id']}")
    if ended["state"] == "rejected":
        missed = [f"{m['figure']} is {m.get('found')} and not {m['wanted']}" for m in ended["missed"]]
        raise Rejected("; ".join(missed))
    if ended["state"] != "succeeded":
        raise Trouble(f"the job is {ended['state']}: {ended.get('error')}")
    print(f"model {ended['model']}: {json.dumps(ended['figures']['novel_view'])}")
    return ended


def light(server, made, name):
    """What a frame is lit by: a map of the server's own, or a file that is uploaded for it."""
    if not name.lower().endswith((".hdr", ".exr")):
        return {"builtin": name}
    media_type = "image/vnd.radiance" if name.lower().endswith(".hdr") else "image/x-exr"
    with made.noting() as note:
        answer = server.ask("POST", "/v1/environments", Path(name).read_bytes(), {"Content-Type": media_type})
        environment = json.loads(answer.body)
        note(f"/v1/environments/{environment['id']}")
    return {"id": environment["id"]}


def render_turn(server, model, environment, options):
    """One EXR a frame, with the relit picture, normals and depth; the camera goes around the thing."""
    options.out.mkdir(parents=True, exist_ok=True)
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
            raise Trouble(f"frame {frame} is no EXR")
        path = options.out / f"relit.{frame + 1:04}.exr"
        # Whoever looks into the folder sees whole frames alone.
        part = path.with_suffix(".part")
        part.write_bytes(answer.body)
        part.replace(path)
        print(f"wrote {path}")


def go_round(server, made, run, options):
    """Everything but the deletion. Job and model are called `run` for other systems, by which they are found again."""
    with Receiver(options.listen) as receiver:
        with made.noting() as note:
            hook = server.json("POST", "/v1/webhooks", {"url": options.hook_url or receiver.url, "events": ENDS})
            note(f"/v1/webhooks/{hook['id']}")
        receiver.secret = hook["secret"]
        capture = make_capture(server, made, options.capture, int(options.piece_mib * 2**20))
        # Should the answer be lost, the same request again makes no second job.
        once = {"Idempotency-Key": run}
        with made.noting() as note:
            job = server.json("POST", "/v1/jobs", {**new_job(options, capture), "external_id": run}, headers=once)
            note(f"/v1/jobs/{job['id']}?cascade=true")
        print(f"job {job['id']}")
        ended = wait_for_end(server, receiver, job, options.patience)
    render_turn(server, ended["model"], light(server, made, options.env), options)


def delete_all(server, made, run):
    made.delete(server)
    # After its job, which makes no other from here on.
    try:
        for model in server.json("GET", f"/v1/models?external_id={run}")["items"]:
            server.delete(f"/v1/models/{model['id']}")
    except (Trouble, *BROKEN) as trouble:
        print(f"not deleted: models called {run}: {trouble}")


def main():
    options = arguments()
    server = Server(options.url, os.environ.get("RELUME_KEY"))
    made, run = Made(), str(uuid.uuid4())
    try:
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
