"""hostile.py HOST:PORT GOOD_KEY BAD_KEY CAPTURE MINUTES: a good tenant alone, then beside a hostile one."""

import collections
import http.client
import io
import itertools
import json
import multiprocessing
import os
import socket
import sys
import threading
import time
import zipfile
import zlib

ADDRESS, GOOD, BAD, CAPTURE, MINUTES = sys.argv[1:6]
ARCHIVE = open(CAPTURE, "rb").read()
# Limits of the good tenant.
MOST_SECONDS = 0.25
MOST_FACTOR = 2.0
# Time alone, seconds.
ALONE = 60


def request(key, method, path, body=None, **headers):
    """Status and content. Statuses of refusals are results, not errors."""
    connection = http.client.HTTPConnection(ADDRESS, timeout=600)
    headers = {"Authorization": f"Bearer {key}"} | {k.replace("_", "-"): v for k, v in headers.items()}
    if isinstance(body, dict):
        body, headers["Content-Type"] = json.dumps(body), "application/json"
    try:
        connection.request(method, path, body, headers)
        answer = connection.getresponse()
        return answer.status, answer.read()
    finally:
        connection.close()


def capture_of(number):
    """A copy of the capture with a unique note, so that the server treats it as another capture."""
    copy = io.BytesIO(ARCHIVE)
    with zipfile.ZipFile(copy, "a") as changed:
        changed.writestr("note.txt", str(number))
    return copy.getvalue()


def white_png(side):
    """A white picture of 8-bit grey, a few kilobytes of any size."""

    def chunk(kind, data):
        return len(data).to_bytes(4) + kind + data + zlib.crc32(kind + data).to_bytes(4)

    header = side.to_bytes(4) * 2 + bytes([8, 0, 0, 0, 0])
    pixels = zlib.compress((b"\0" + b"\xff" * side) * side, 9)
    return b"\x89PNG\r\n\x1a\n" + chunk(b"IHDR", header) + chunk(b"IDAT", pixels) + chunk(b"IEND", b"")


def bomb():
    """A capture of six photographs of 36 million pixels each in a few kilobytes."""
    frame = {"transform_matrix": [[1, 0, 0, 0], [0, 1, 0, 0], [0, 0, 1, 4], [0, 0, 0, 1]]}
    frames = [{"file_path": f"{i}.png", **frame} for i in range(6)]
    out = io.BytesIO()
    with zipfile.ZipFile(out, "w", zipfile.ZIP_DEFLATED) as archive:
        archive.writestr("transforms.json", json.dumps({"camera_angle_x": 0.7, "frames": frames}))
        picture = white_png(6000)
        for i in range(6):
            archive.writestr(f"{i}.png", picture)
    return out.getvalue()


class Good:
    """The requests of a pipeline, with their times."""

    def __init__(self, number):
        status, made = request(GOOD, "POST", "/v1/captures", capture_of(f"good {number}"), Content_Type="application/zip")
        self.capture = self.checked(status, made)["id"]
        self.firsts, self.thumbnails, self.validations, self.jobs = [], [], [], []
        self.model, self.shown = None, None

    @staticmethod
    def checked(status, content):
        if not 200 <= status < 300:
            sys.exit(f"the good tenant got {status}: {content[:300]!r}")
        return json.loads(content)

    def job(self):
        overrides = {"iterations": 150, "resolution": 64, "max_gaussians": 2000, "initial_gaussians": 1000}
        start = time.monotonic()
        body = {"capture": self.capture, "preset": "draft", "overrides": overrides}
        made = self.checked(*request(GOOD, "POST", "/v1/jobs", body))
        # The event stream ends when the job ends.
        request(GOOD, "GET", f"/v1/jobs/{made['id']}/events", Accept="text/event-stream")
        ended = self.checked(*request(GOOD, "GET", f"/v1/jobs/{made['id']}"))
        if ended["state"] != "succeeded":
            sys.exit(f"a job of the good tenant ended as {ended['state']}")
        self.jobs.append(time.monotonic() - start)
        self.model = ended["model"]

    def thumbnail(self, azimuth):
        start = time.monotonic()
        model = self.model
        path = f"/v1/models/{model}/thumbnail?env=sunset&size=128&azimuth={azimuth:.2f}"
        status, content = request(GOOD, "GET", path)
        if status != 200:
            sys.exit(f"a thumbnail of the good tenant: {status} {content[:300]!r}")
        times = self.thumbnails if model == self.shown else self.firsts
        times.append(time.monotonic() - start)
        self.shown = model

    def validation(self):
        start = time.monotonic()
        status, content = request(GOOD, "POST", "/v1/captures/validate", ARCHIVE, Content_Type="application/zip")
        if status != 200:
            sys.exit(f"a validation of the good tenant: {status} {content[:300]!r}")
        self.validations.append(time.monotonic() - start)

    def run(self, seconds):
        self.job()
        end = time.monotonic() + seconds
        done = threading.Event()
        failures = []

        def repeat(act, pause):
            try:
                for i in itertools.count():
                    if time.monotonic() > end or done.is_set():
                        return
                    act(i)
                    time.sleep(pause)
            except SystemExit as failure:
                failures.append(failure)
                done.set()

        acts = [(lambda i: self.job(), 1), (lambda i: self.thumbnail(i * 0.37 % 360), 0.2), (lambda i: self.validation(), 2)]
        threads = [threading.Thread(target=repeat, args=act) for act in acts]
        [thread.start() for thread in threads]
        [thread.join() for thread in threads]
        if failures:
            raise failures[0]


class Bad:
    """What one tenant can send at most."""

    def __init__(self):
        self.answers = collections.Counter()
        self.stopped = threading.Event()
        self.bomb = bomb()
        status, made = request(BAD, "POST", "/v1/captures", capture_of("bad"), Content_Type="application/zip")
        self.capture = json.loads(made)["id"]
        overrides = {"iterations": 20, "resolution": 48, "max_gaussians": 300, "initial_gaussians": 200}
        self.tiny = {"capture": self.capture, "preset": "draft", "overrides": overrides}
        status, job = request(BAD, "POST", "/v1/jobs", self.tiny)
        job = json.loads(job)["id"]
        self.queued = job
        request(BAD, "GET", f"/v1/jobs/{job}/events", Accept="text/event-stream")
        self.model = json.loads(request(BAD, "GET", f"/v1/jobs/{job}")[1])["model"]

    def start(self):
        acts = [(self.validate, 16), (self.slow_upload, 32), (self.flood, 2), (self.mesh, 4), (self.thumbnails, 8), (self.listen, 40)]
        for act, count in acts:
            for number in range(count):
                threading.Thread(target=self.repeat, args=(act, number), daemon=True).start()

    def repeat(self, act, number):
        for i in itertools.count(number * 100_000):
            if self.stopped.is_set():
                return
            try:
                status = act(i)
            except OSError as error:
                status = type(error).__name__
            self.answers[f"{act.__name__} {status}"] += 1
            if status != 200:
                time.sleep(1)

    def validate(self, _):
        return request(BAD, "POST", "/v1/captures/validate", self.bomb, Content_Type="application/zip")[0]

    def slow_upload(self, _):
        """An upload of one byte a second."""
        host, port = ADDRESS.split(":")
        with socket.create_connection((host, int(port)), timeout=60) as connection:
            head = f"POST /v1/captures HTTP/1.1\r\nHost: {ADDRESS}\r\nAuthorization: Bearer {BAD}\r\nContent-Type: application/zip\r\n"
            connection.sendall((head + "Content-Length: 1000000\r\n\r\n").encode())
            while not self.stopped.wait(1):
                connection.sendall(b"P")
        return "stopped"

    def flood(self, _):
        status, job = request(BAD, "POST", "/v1/jobs", self.tiny)
        if status in (200, 201, 202):
            self.queued = json.loads(job)["id"]
        return status

    def mesh(self, i):
        status, made = request(BAD, "POST", f"/v1/models/{self.model}/exports", {"kind": "mesh", "cells": 320})
        if status in (200, 201, 202) and i % 2:
            time.sleep(2)
            request(BAD, "DELETE", f"/v1/exports/{json.loads(made)['id']}")
        return status

    def thumbnails(self, i):
        path = f"/v1/models/{self.model}/thumbnail?env=studio&size=256&azimuth={i * 0.01 % 360:.2f}"
        return request(BAD, "GET", path)[0]

    def listen(self, _):
        return request(BAD, "GET", f"/v1/jobs/{self.queued}/events", Accept="text/event-stream")[0]


def hostile(stop, answers):
    """The process of the hostile tenant. It has a low priority, because a real one would not share the processors with the server."""
    os.nice(10)
    bad = Bad()
    bad.start()
    stop.wait()
    bad.stopped.set()
    answers.put(dict(bad.answers))


def percentile(values, share):
    return sorted(values)[min(len(values) - 1, int(share * len(values)))]


def told(name, good):
    """Prints the figures of a run."""
    figures = {"thumbnails": good.thumbnails, "first ones": good.firsts, "validations": good.validations, "jobs": good.jobs}
    for what, values in figures.items():
        middle, most = percentile(values, 0.5), percentile(values, 0.99)
        print(f"{name:8} {what:12} {len(values):5}  median {middle:6.3f} s  p99 {most:6.3f} s  largest {max(values):6.3f} s")


def main():
    alone = Good(1)
    alone.run(ALONE)
    told("alone", alone)
    stop, answers = multiprocessing.Event(), multiprocessing.Queue()
    bad = multiprocessing.Process(target=hostile, args=(stop, answers), daemon=True)
    bad.start()
    beside = Good(2)
    beside.run(60 * float(MINUTES))
    stop.set()
    told("beside", beside)
    received = sorted(answers.get(timeout=60).items())
    print("answers to the hostile tenant:", ", ".join(f"{what}: {count}" for what, count in received))
    slow = percentile(beside.thumbnails, 0.99)
    factor = percentile(beside.jobs, 0.5) / percentile(alone.jobs, 0.5)
    print(f"jobs take {factor:.2f} times their time alone")
    if not (slow <= MOST_SECONDS and factor <= MOST_FACTOR):
        sys.exit(f"too slow: at most {MOST_SECONDS} s in the 99th percentile and {MOST_FACTOR} times are allowed")


if __name__ == "__main__":
    main()
