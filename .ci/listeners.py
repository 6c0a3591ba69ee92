"""listeners.py HOST:PORT KEY CAPTURE COUNT: steps per second of a training without and with listeners."""

import http.client
import json
import socket
import sys
import threading
import time

ADDRESS, KEY, CAPTURE, COUNT = sys.argv[1:5]
# Duration of each measurement, seconds.
SECONDS = 15


def request(method, path, body=None, content_type="application/json"):
    connection = http.client.HTTPConnection(ADDRESS, timeout=60)
    connection.request(method, path, json.dumps(body) if isinstance(body, dict) else body, {"Authorization": f"Bearer {KEY}", "Content-Type": content_type})
    answer = connection.getresponse()
    content = answer.read()
    connection.close()
    if answer.status >= 300:
        sys.exit(f"{method} {path}: {answer.status} {content[:300]!r}")
    return json.loads(content or "null")


def job(capture):
    # Without a warm-up, whose steps are faster, and without growth.
    overrides = {"iterations": 50_000, "warm_up": 0.0, "half_resolution": 0.0, "densify_until": 0.0, "resolution": 64, "max_gaussians": 2000, "initial_gaussians": 1000}
    return request("POST", "/v1/jobs", {"capture": capture, "preset": "draft", "overrides": overrides})["id"]


def rate(running):
    """Steps per second over the next seconds."""

    def at():
        return request("GET", f"/v1/jobs/{running}")["progress"]["step"], time.monotonic()

    (before, start), _ = at(), time.sleep(SECONDS)
    after, end = at()
    return (after - before) / (end - start)


class Listeners:
    """Open event streams, which one thread reads and discards."""

    def __init__(self, job):
        host, port = ADDRESS.split(":")
        head = f"GET /v1/jobs/{job}/events HTTP/1.1\r\nHost: {ADDRESS}\r\nAuthorization: Bearer {KEY}\r\nAccept: text/event-stream\r\n\r\n"
        self.open = [socket.create_connection((host, int(port))) for _ in range(int(COUNT))]
        for one in self.open:
            one.sendall(head.encode())
            one.settimeout(0)
        self.heard = 0
        self.ended = threading.Event()
        self.thread = threading.Thread(target=self.read)
        self.thread.start()

    def read(self):
        while not self.ended.wait(0.2):
            for one in self.open:
                try:
                    self.heard += len(one.recv(65536)) > 0
                except BlockingIOError:
                    pass

    def close(self):
        self.ended.set()
        self.thread.join()
        for one in self.open:
            one.close()


def main():
    capture = request("POST", "/v1/captures", open(CAPTURE, "rb").read(), "application/zip")["id"]
    running, waiting = job(capture), job(capture)
    while request("GET", f"/v1/jobs/{running}")["progress"]["step"] < 300:
        time.sleep(0.2)
    print(f"alone: {rate(running):.1f} steps/s")
    for whose, listened in (("another job", waiting), ("the training", running)):
        listeners = Listeners(listened)
        time.sleep(3)
        steps = rate(running)
        listeners.close()
        if not listeners.heard:
            sys.exit("the listeners heard nothing")
        print(f"{COUNT} listeners to {whose}: {steps:.1f} steps/s, {listeners.heard} reads")
    print(f"alone again: {rate(running):.1f} steps/s")


if __name__ == "__main__":
    main()
