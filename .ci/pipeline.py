"""pipeline.py HOST:PORT KEY FOLDER: runs examples/pipeline and checks its frames, its messages and that it leaves nothing on the server."""

import json
import os
import signal
import socket
import struct
import subprocess
import sys
import threading
import urllib.request
from pathlib import Path

ADDRESS, KEY, FOLDER = sys.argv[1], sys.argv[2], Path(sys.argv[3])
EXAMPLE = Path(__file__).resolve().parent.parent / "examples" / "pipeline"
sys.path.insert(0, str(EXAMPLE))
from webhook import is_genuine  # noqa: E402

TINY = ["--set", "iterations=30", "--set", "resolution=32", "--set", "max_gaussians=64", "--patience", "120"]
# The numbers of the chunks that the proxy cuts, counted over all connections.
CUTS = [2, 3]
CUT_AFTER = 30_000


def cutting_proxy():
    """Starts a proxy to the server that cuts the connection in the middle of the chunks CUTS. Returns its URL and the list of cuts made so far."""
    listener = socket.create_server(("127.0.0.1", 0))
    pieces, cuts = [], []

    def pump(source, target, cut):
        carried = 0
        try:
            while data := source.recv(65536):
                carried += len(data)
                if cut and carried > CUT_AFTER:
                    target.sendall(data[: max(0, len(data) - (carried - CUT_AFTER))])
                    break
                target.sendall(data)
        except OSError:
            pass
        for end in (source, target) if cut else (target,):
            try:
                end.shutdown(socket.SHUT_RDWR if cut else socket.SHUT_WR)
            except OSError:
                pass

    def serve(client):
        if client.recv(5, socket.MSG_PEEK) == b"PATCH":
            pieces.append(client)
        cut = len(pieces) in CUTS and pieces[-1] is client
        if cut:
            cuts.append(len(pieces))
        host, port = ADDRESS.split(":")
        with client, socket.create_connection((host, int(port))) as server:
            back = threading.Thread(target=pump, args=(server, client, False))
            back.start()
            pump(client, server, cut)
            back.join()

    def accept():
        while True:
            threading.Thread(target=serve, args=(listener.accept()[0],), daemon=True).start()

    threading.Thread(target=accept, daemon=True).start()
    return f"http://127.0.0.1:{listener.getsockname()[1]}", cuts


def run(url, *options, key=KEY, capture="capture.zip", stop_at=None):
    """Runs the example. Returns its exit status, its output and its frames. Sends SIGTERM when a line of its output begins with `stop_at`."""
    out = FOLDER / f"frames{len(list(FOLDER.glob('frames*')))}"
    out.mkdir()
    command = [sys.executable, "-u", str(EXAMPLE / "relight.py"), str(FOLDER / capture), str(out), "--url", url, *TINY, *options]
    pipes = {"stdout": subprocess.PIPE, "stderr": subprocess.STDOUT, "text": True}
    said = ""
    with subprocess.Popen(command, env={**os.environ, "RELUME_API_KEY": key}, **pipes) as process:
        late = threading.Timer(240, process.kill)
        late.start()
        for line in process.stdout:
            print(line, end="")
            said += line
            if stop_at and line.startswith(stop_at):
                process.send_signal(signal.SIGTERM)
        late.cancel()
    return process.returncode, said, sorted(out.iterdir())


def channels_of_parts(exr):
    """The channels of each part of a multi-part EXR, from its headers."""
    magic, version = struct.unpack_from("<ii", exr)
    assert magic == 20000630, "not an EXR file"
    at, parts = 8, []
    while exr[at] != 0:
        while exr[at] != 0:
            name, kind = (exr[at:].split(b"\0", 2))[:2]
            at += len(name) + len(kind) + 2
            size = struct.unpack_from("<i", exr, at)[0]
            value, at = exr[at + 4 : at + 4 + size], at + 4 + size
            if name == b"channels":
                parts.append(list(channel_names(value)))
        at += 1
        if not version & 0x1000:
            break
    return parts


def channel_names(value):
    at = 0
    while value[at] != 0:
        name = value[at:].split(b"\0", 1)[0]
        yield name.decode()
        at += len(name) + 1 + 16


def assert_nothing_is_left():
    def get(path):
        request = urllib.request.Request(f"http://{ADDRESS}{path}", headers={"Authorization": f"Bearer {KEY}"})
        with urllib.request.urlopen(request) as answer:
            return json.load(answer)

    for kind in ["captures", "environments", "jobs", "models", "webhooks"]:
        assert get(f"/v1/{kind}")["items"] == [], f"the server still has {kind}"
    usage = get("/v1/usage")
    for kind in ["captures", "environments", "models", "uploads", "checkpoints"]:
        assert usage[kind]["count"] == 0, f"the server still has {kind}: {usage}"


def check_signatures():
    """The receiver accepts the example of the standard and refuses each variation of it."""
    secret, sent_at = "whsec_MfKQ9r8GKYqrTwjUPD8ILPZIo2LaLaSw", 1614265330
    headers = {
        "webhook-id": "msg_p5jXN8AQM9LWM0D4loKWxJek",
        "webhook-timestamp": str(sent_at),
        "webhook-signature": "v2,other v1,g0hM9SsE+OTPJTGt/tmIKtSyZlE3uFJELVlNIOLJ1OE=",
    }
    body = b'{"test": 2432232314}'
    assert is_genuine(secret, headers, body, sent_at + 10)
    assert not is_genuine(secret, headers, body + b" ", sent_at + 10), "another body"
    assert not is_genuine("whsec_" + "A" * 32, headers, body, sent_at + 10), "another secret"
    assert not is_genuine(secret, {**headers, "webhook-id": "msg_x"}, body, sent_at + 10), "another identifier"
    assert not is_genuine(secret, headers, body, sent_at + 3600), "an old message"
    assert not is_genuine(secret, {}, body, sent_at), "no signature"


def main():
    check_signatures()
    url, cuts = cutting_proxy()
    gate = ["--gate", "novel_view_matched.psnr>=5"]
    sizes = ["--frames", "3", "--size", "64", "--piece-mib", "0.1"]
    status, said, frames = run(url, *gate, *sizes, "--env", "sunset")
    assert status == 0 and cuts == CUTS, f"exit status {status}, cuts {cuts}"
    assert said.count("goes on at byte 104857 of") == 2, "the upload did not resume at the last stored byte"
    assert "a webhook says job.succeeded" in said
    assert [f.name for f in frames] == [f"relit.{n:04}.exr" for n in (1, 2, 3)]
    contents = [frame.read_bytes() for frame in frames]
    assert len(set(contents)) == 3, "some frames are equal"
    for content in contents:
        channels = {channel.rpartition(".")[2] for part in channels_of_parts(content) for channel in part}
        assert {"R", "G", "B", "A", "X", "Y", "Z"} <= channels, channels
    assert_nothing_is_left()

    # An uploaded environment map: 16 x 8 equal RGBE pixels.
    light = FOLDER / "grey.hdr"
    light.write_bytes(b"#?RADIANCE\nFORMAT=32-bit_rle_rgbe\n\n-Y 8 +X 16\n" + bytes([128, 128, 128, 129]) * 128)
    status, _, frames = run(url, "--frames", "1", "--size", "64", "--env", str(light))
    assert status == 0 and frames[0].read_bytes() != contents[0], "the frame is the same under another light"
    assert_nothing_is_left()

    status, said, frames = run(url, "--gate", "novel_view.psnr>=99")
    assert status == 2 and frames == [], f"ended with {status}"
    assert "a webhook says job.rejected" in said and "rejected: novel_view.psnr is" in said
    assert_nothing_is_left()
    status, said, _ = run(url, key="a-key-that-nobody-has")
    assert status == 1 and "not deleted" not in said and "failed: POST /v1/webhooks: 401" in said, f"ended with {status}"
    status, said, _ = run(url, "--gate", "nonsense>=1")
    assert status == 1 and "quality_gate" in said, f"ended with {status}"
    (FOLDER / "bad.hdr").write_bytes(b"junk")
    # The script must refuse these options before it uploads anything.
    refused = [("--env", "nope", "--env nope: neither"), ("--env", "missing.hdr", "missing.hdr"), ("--env", str(FOLDER / "bad.hdr"), "does not begin")]
    refused += [("--piece-mib", "0", "--piece-mib"), ("--frames", "0", "--frames"), ("--set", "foo", "--set: foo"), ("--gate", "foo", "--gate: foo")]
    for option, value, sentence in refused:
        status, said, _ = run(url, option, value)
        assert status == 1 and sentence in said and "\ncapture " not in "\n" + said, f"{option} {value} ended with {status}"
        assert "not deleted" not in said
    assert_nothing_is_left()
    (FOLDER / "none.zip").write_bytes(b"PK\5\6" + bytes(18))
    status, said, _ = run(url, capture="none.zip")
    assert status == 1 and "is no capture" in said, f"ended with {status}"
    assert_nothing_is_left()
    # SIGTERM during training, and before the job exists.
    status, said, _ = run(url, "--set", "iterations=100000", stop_at="job ")
    assert status == 1 and "stopped" in said and "not deleted" not in said, f"ended with {status}"
    assert_nothing_is_left()
    status, said, _ = run(url, stop_at="capture ")
    assert status == 1 and "stopped" in said and "not deleted" not in said, f"ended with {status}"
    assert_nothing_is_left()
    print("the pipeline completed, refused the controls and left nothing on the server")


main()
