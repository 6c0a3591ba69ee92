"""Against a server that is made up: what a real one does seldom."""

from __future__ import annotations

import json
import zipfile
from pathlib import Path
from typing import Any

import httpx
import pytest

import relume
import relume.http
import relume.uploads


@pytest.fixture(autouse=True)
def no_waiting(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("time.sleep", lambda seconds: None)


def client(answer: Any) -> relume.Client:
    return relume.Client(key="secret", transport=httpx.MockTransport(answer))


class Uploads:
    """A server of uploads that fails as often as it is told to."""

    def __init__(self, breaks: int) -> None:
        self.breaks = breaks
        self.stored = b""
        self.length = 0

    def __call__(self, request: httpx.Request) -> httpx.Response:
        assert request.headers["authorization"] == "Bearer secret"
        if request.method == "POST" and request.url.path == "/v1/uploads":
            self.length = int(request.headers["upload-length"])
            return httpx.Response(201, headers={"location": "/v1/uploads/u1"})
        if request.method == "HEAD":
            return httpx.Response(200, headers={"upload-offset": str(len(self.stored))})
        if request.method == "PATCH":
            assert int(request.headers["upload-offset"]) == len(self.stored)
            self.breaks -= 1
            if self.breaks >= 0:
                # Half of it arrived.
                self.stored += request.content[: len(request.content) // 2]
                raise httpx.ReadError("cut off")
            self.stored += request.content
            return httpx.Response(204, headers={"upload-offset": str(len(self.stored))})
        assert (request.url.path, json.loads(request.content)) == ("/v1/captures", {"upload": "u1"})
        return httpx.Response(201, json={"id": "c1"})


def test_a_capture_is_waited_for_and_says_why_it_is_invalid() -> None:
    problem = {"type": "urn:relume:problem:no-poses", "title": "No poses", "status": 422, "detail": "3 of 8"}
    for state, more in [("ready", {}), ("invalid", {"problem": problem})]:
        states = [{"state": "validating", "poses": {"stage": "matching", "done": 0.5}}, {"state": state, **more}]

        def answer(request: httpx.Request, states: list[dict[str, Any]] = states) -> httpx.Response:
            assert request.url.path == "/v1/captures/c1"
            return httpx.Response(200, json={"id": "c1", **(states.pop(0) if states else {})})

        capture = client(answer).capture("c1")
        assert capture.state == "validating"
        if state == "ready":
            assert capture.wait() is capture
            continue
        with pytest.raises(relume.RelumeError) as caught:
            capture.wait()
        assert caught.value.kind == "no-poses" and "3 of 8" in str(caught.value)


@pytest.mark.parametrize("breaks", [0, 1, 5])
def test_an_upload_goes_on_where_it_was_cut(breaks: int, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(relume.uploads, "_PIECE", 1000)
    data = bytes(i % 251 for i in range(4321))
    (tmp_path / "capture.zip").write_bytes(data)
    server = Uploads(breaks)
    assert client(server).upload_capture(tmp_path / "capture.zip").id == "c1"
    assert server.stored == data and server.length == len(data)


def test_an_upload_that_never_gets_on_ends(tmp_path: Path) -> None:
    (tmp_path / "capture.zip").write_bytes(b"x" * 10)

    def broken(request: httpx.Request) -> httpx.Response:
        if request.method == "PATCH":
            raise httpx.ConnectError("down")
        return httpx.Response(201, headers={"location": "/v1/uploads/u1", "upload-offset": "0"})

    with pytest.raises(relume.Unreachable):
        client(broken).upload_capture(tmp_path / "capture.zip")


def test_a_folder_becomes_an_archive_of_its_files(tmp_path: Path) -> None:
    (tmp_path / "thing/images").mkdir(parents=True)
    (tmp_path / "thing/images/a.jpg").write_bytes(b"a")
    (tmp_path / "thing/transforms.json").write_bytes(b"{}")
    with relume.uploads.archive_of(tmp_path / "thing") as (file, length, name):
        assert name == "thing.zip" and length > 0
        assert zipfile.ZipFile(file).namelist() == ["images/a.jpg", "transforms.json"]
    (tmp_path / "empty").mkdir()
    with pytest.raises(FileNotFoundError), relume.uploads.archive_of(tmp_path / "empty"):
        pass


def test_a_busy_server_is_asked_again_and_a_refusal_names_the_field() -> None:
    answers = [
        httpx.Response(503, headers={"retry-after": "1"}, json={}),
        httpx.Response(429, json={}),
        httpx.Response(
            422,
            json={
                "type": "urn:relume:problem:invalid",
                "title": "Invalid",
                "errors": [{"pointer": "/preset", "detail": "is unknown"}],
                "request_id": "r1",
            },
        ),
    ]
    with pytest.raises(relume.RelumeError, match="/preset: is unknown") as caught:
        client(lambda request: answers.pop(0)).usage()
    assert (caught.value.status, caught.value.kind, caught.value.request_id) == (422, "invalid", "r1")
    assert not answers
    with pytest.raises(relume.RelumeError) as caught:
        client(lambda request: httpx.Response(503, json={})).usage()
    assert caught.value.status == 503


def test_lists_are_read_to_their_end() -> None:
    def pages(request: httpx.Request) -> httpx.Response:
        before = request.url.params.get("before")
        items = [{"id": "b"}] if before == "a" else [{"id": "a"}]
        return httpx.Response(200, json={"items": items, "next": None if before else "a"})

    assert [job.id for job in client(pages).jobs(state="queued")] == ["a", "b"]


def test_a_job_that_failed_says_why() -> None:
    data: dict[str, Any] = {"id": "j", "state": "queued", "progress": {"step": 0, "total": 9}}
    ends = [
        {**data, "state": "running", "progress": {"step": 3, "total": 9, "psnr": 20.5}},
        {**data, "state": "rejected", "missed": [{"figure": "novel_view.psnr", "wanted": ">=28", "found": 21.5}]},
    ]
    seen: list[str] = []
    job = relume.Job(client(lambda request: httpx.Response(200, json=ends.pop(0)))._connection, data)
    with pytest.raises(relume.JobFailed, match="novel_view.psnr is 21.5, wanted >=28"):
        job.wait(progress=False, on_progress=lambda told: seen.append(told["state"]))
    assert seen == ["running", "rejected"]
    running = client(lambda request: httpx.Response(200, json={**data, "state": "running"}))
    with pytest.raises(TimeoutError):
        relume.Job(running._connection, data).wait(progress=False, timeout=0)


def test_a_download_is_whole_or_not_there(tmp_path: Path) -> None:
    def cut(request: httpx.Request) -> httpx.Response:
        def body() -> Any:
            yield b"half"
            raise httpx.ReadError("cut off")

        return httpx.Response(200, content=body())

    whole = relume.Model(client(lambda request: httpx.Response(200, content=b"whole"))._connection, {"id": "m"})
    assert whole.download("model.safetensors", tmp_path / "m").read_bytes() == b"whole"
    broken = relume.Model(client(cut)._connection, {"id": "m"})
    with pytest.raises(relume.Unreachable):
        broken.download("model.safetensors", tmp_path / "other")
    assert [p.name for p in tmp_path.iterdir()] == ["m"]


def test_an_object_store_that_a_server_leads_to_is_not_told_the_key(tmp_path: Path) -> None:
    asked = []

    def answer(request: httpx.Request) -> httpx.Response:
        asked.append((request.url.host, "authorization" in request.headers))
        if request.url.host == "objects.example":
            return httpx.Response(200, content=b"ply")
        return httpx.Response(307, headers={"location": "https://objects.example/m?signature=s"})

    model = relume.Model(client(answer)._connection, {"id": "m"})
    assert model.download("model.ply", tmp_path / "m").read_bytes() == b"ply"
    assert asked == [("127.0.0.1", True), ("objects.example", False)]


def test_a_calibration_sends_the_patch_and_keeps_the_changed_model() -> None:
    sent: list[tuple[str, str, Any]] = []

    def answer(request: httpx.Request) -> httpx.Response:
        sent.append((request.method, request.url.path, json.loads(request.content or b"null")))
        calibration = {"calibration": {"scale": [2, 2, 2]}} if request.method == "PUT" else {}
        return httpx.Response(200, json={"id": "m", **calibration})

    model = relume.Model(client(answer)._connection, {"id": "m"})
    assert model.calibration is None
    assert model.calibrate("a.jpg", (1, 2, 3, 4), 0.18) == {"scale": [2, 2, 2]} == model.calibration
    model.calibrate("a.jpg", (1, 2, 3, 4), (0.1, 0.2, 0.3))
    model.undo_calibration()
    assert model.calibration is None
    patch = {"photo": "a.jpg", "x": 1, "y": 2, "width": 3, "height": 4}
    path = "/v1/models/m/calibration"
    assert sent == [
        ("PUT", path, {"patch": patch, "reflectance": 0.18}),
        ("PUT", path, {"patch": patch, "reflectance": [0.1, 0.2, 0.3]}),
        ("DELETE", path, None),
    ]


def test_an_orbit_looks_at_its_target_from_its_distance() -> None:
    look = relume.orbit(90, 0, 2.0, (1.0, 1.0, 1.0))["look_at"]
    assert look["eye"] == pytest.approx([1.0, 3.0, 1.0])
    assert relume.orbit(0, 90, 2.0)["look_at"]["eye"] == pytest.approx([0.0, 0.0, 2.0])
