"""soak.py HOST:PORT KEY FOLDER PID MINUTES: repeats the requests of a pipeline and prints the server's memory each minute."""

import http.client
import io
import json
import sys
import time
import zipfile
from pathlib import Path

ADDRESS, KEY, FOLDER, SERVER, MINUTES = sys.argv[1:6]
# Limit for the peak memory of the last third of the run divided by that of the second third, when the caches are full.
MOST_GROWTH = 1.15


class Api:
    def __init__(self):
        self.host = ADDRESS
        self.requests = 0

    def __call__(self, method, path, body=None, expected=(200, 201, 202, 204), **headers):
        connection = http.client.HTTPConnection(self.host, timeout=120)
        headers = {"Authorization": f"Bearer {KEY}"} | {k.replace("_", "-"): v for k, v in headers.items()}
        if isinstance(body, dict):
            body, headers["Content-Type"] = json.dumps(body), "application/json"
        connection.request(method, path, body, headers)
        answer = connection.getresponse()
        content = answer.read()
        connection.close()
        self.requests += 1
        if answer.status not in expected:
            sys.exit(f"{method} {path}: {answer.status} {content[:400]!r}")
        is_json = "json" in answer.getheader("Content-Type", "")
        return json.loads(content) if is_json else content


def capture(archive, number):
    """A copy of the archive with a unique note, so that the server treats it as another capture."""
    copy = io.BytesIO(archive)
    with zipfile.ZipFile(copy, "a") as changed:
        changed.writestr("note.txt", str(number))
    return copy.getvalue()


def a_round(api, archive, number):
    made = api("POST", "/v1/captures", capture(archive, number), Content_Type="application/zip")
    overrides = {"iterations": 20, "resolution": 48, "max_gaussians": 300, "initial_gaussians": 200, "checkpoint_every": 10}
    job = api("POST", "/v1/jobs", {"capture": made["id"], "preset": "draft", "overrides": overrides})
    # The event stream ends when the job ends, so this request waits for the job.
    api("GET", f"/v1/jobs/{job['id']}/events", Accept="text/event-stream")
    model = api("GET", f"/v1/jobs/{job['id']}")["model"]
    for azimuth in range(0, 360, 30):
        api("GET", f"/v1/models/{model}/thumbnail?env=sunset&size=128&azimuth={azimuth + number % 30}")
    frame = {
        "camera": {"look_at": {"eye": [3, 0, 1.5], "target": [0, 0, 0], "fov_y_deg": 40}},
        "environment": {"builtin": "studio", "rotation_deg": number % 360},
        "width": 256, "height": 256, "outputs": ["rgb", "normal", "albedo", "depth"],
    }
    api("POST", f"/v1/models/{model}/render", frame, Accept="image/x-exr")
    api("POST", f"/v1/models/{model}/render", frame | {"width": 0}, expected=(422,))
    api("POST", "/v1/captures", b"no archive", expected=(422,), Content_Type="application/zip")
    for path in ("/v1/jobs", "/v1/models", "/v1/captures", "/v1/usage", "/metrics"):
        api("GET", path)
    api("DELETE", f"/v1/captures/{made['id']}?cascade=true")
    api("DELETE", f"/v1/models/{model}", expected=(200, 202, 204, 404))


def resident():
    status = Path(f"/proc/{SERVER}/status").read_text()
    return int(next(line.split()[1] for line in status.splitlines() if line.startswith("VmRSS"))) / 1024


def files():
    return len(list(Path(f"/proc/{SERVER}/fd").iterdir()))


def main():
    api, archive = Api(), (Path(FOLDER) / "capture.zip").read_bytes()
    end = time.monotonic() + 60 * float(MINUTES)
    rounds, memory, next_look = 0, [], time.monotonic()
    while time.monotonic() < end:
        a_round(api, archive, rounds)
        rounds += 1
        if time.monotonic() >= next_look:
            memory.append(resident())
            print(f"round {rounds}, {api.requests} requests, {memory[-1]:.0f} MiB, {files()} files open", flush=True)
            next_look += 60
    third = len(memory) // 3
    if third:
        middle, last = (max(memory[i * third:(i + 1) * third]) for i in (1, 2))
        if last > MOST_GROWTH * middle:
            sys.exit(f"memory grew from {middle:.0f} to {last:.0f} MiB")
    usage = api("GET", "/v1/usage")
    left = {kind: usage[kind] for kind in ("captures", "models", "checkpoints") if usage[kind].get("count", 0)}
    if left:
        sys.exit(f"not deleted: {left}")
    print(f"{rounds} rounds, {api.requests} requests, no failures")


main()
