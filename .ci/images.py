"""images.py DOCKERFILE ROOT IMAGE PROGRAM: replays the instructions of a Dockerfile in copies of a Debian root, and uses the service of its last stage.

IMAGE is the folder of the last stage, which this script makes. PROGRAM takes the place of the file that the build stage compiles, unless RELUME_IMAGES_BUILD=1
has that stage replayed with the toolchain of this machine.
"""

import json
import os
import pathlib
import re
import shlex
import shutil
import signal
import socket
import subprocess
import sys
import time
from contextlib import contextmanager

REPOSITORY = pathlib.Path(__file__).resolve().parents[1]
PATH = "/usr/local/sbin:/usr/local/bin:/usr/sbin:/usr/bin:/sbin:/bin"
KEY = "a-key-for-this-run-alone"
# Packages of the official image of Rust, which the build stage begins with.
OF_RUST_IMAGE = "apt-get update && apt-get install --yes --no-install-recommends ca-certificates gcc libc6-dev"
# Seconds until a server must listen, and until it must have ended.
START_LIMIT, END_LIMIT = 30, 60


def instructions(text):
    """The instructions of a Dockerfile: name and argument, without comments, continued lines joined."""
    lines = "\n".join(line for line in text.splitlines() if not line.startswith("#"))
    for line in re.sub(r"\\\n\s*", " ", lines).splitlines():
        if line.strip():
            name, _, argument = line.strip().partition(" ")
            yield name, argument.strip()


def stages(text):
    """The instructions by stage; each stage begins with its FROM."""
    found = []
    for name, argument in instructions(text):
        if name == "FROM":
            found.append([])
        found[-1].append((name, argument))
    return found


class Stage:
    """A stage that is replayed in the folder `root`, a copy of a Debian root."""

    def __init__(self, base, root):
        subprocess.run(["cp", "-a", "--reflink=auto", base, root], check=True)
        self.root, self.environment, self.folder, self.last = root, {"PATH": PATH, "HOME": "/root"}, "/", {}

    def run(self, command):
        """Runs a shell command in the root, as root."""
        script = f"cd {shlex.quote(self.folder)} && {command}"
        done = subprocess.run(["chroot", self.root, "/bin/sh", "-c", script], env=self.environment, capture_output=True, text=True)
        if done.returncode:
            raise SystemExit(f"RUN {command} ends with {done.returncode}:\n{done.stdout[-2000:]}{done.stderr[-2000:]}")

    def copy(self, argument, built):
        """COPY from the repository or, with --from=build, of the compiled program."""
        *sources, target = argument.split()
        place = self.root / (target if target.startswith("/") else f"{self.folder}/{target}").lstrip("/")
        if sources[0] == "--from=build":
            shutil.copy2(built, place)
        elif sources == ["."]:
            files = subprocess.run(["git", "ls-files", "-z"], cwd=REPOSITORY, capture_output=True, check=True).stdout
            subprocess.run(["cp", "--parents", "-t", place, *[name for name in files.decode().split("\0") if name]], cwd=REPOSITORY, check=True)
        else:
            shutil.copy2(REPOSITORY / sources[0], place)

    def replay(self, steps, built):
        for name, argument in steps:
            if name == "RUN":
                self.run(argument)
            elif name == "COPY":
                self.copy(argument, built)
            elif name in ("ENV", "ARG"):
                self.environment |= dict(part.partition("=")[::2] for part in shlex.split(argument))
            elif name == "WORKDIR":
                self.folder = argument
                (self.root / argument.lstrip("/")).mkdir(parents=True, exist_ok=True)
            elif name in ("USER", "ENTRYPOINT", "CMD", "HEALTHCHECK", "STOPSIGNAL"):
                self.last[name] = argument
            elif name not in ("FROM", "VOLUME", "EXPOSE"):
                raise SystemExit(f"{name} is an instruction that this script does not replay")

    def command(self, *arguments):
        """ENTRYPOINT with arguments, or with CMD, as the user of the image."""
        words = json.loads(self.last["ENTRYPOINT"]) + (list(arguments) or json.loads(self.last["CMD"]))
        return ["chroot", f"--userspec={self.last['USER']}", self.root, *words]

    def health_check(self):
        words = json.loads(self.last["HEALTHCHECK"].partition("CMD ")[2])
        return ["chroot", f"--userspec={self.last['USER']}", self.root, *words]


def built_program(steps, base, root):
    """Replays the build stage with the toolchain of this machine. Returns the compiled program."""
    stage = Stage(base, root)
    toolchain = subprocess.run(["rustc", "--print", "sysroot"], cwd=REPOSITORY, capture_output=True, text=True, check=True).stdout.strip()
    subprocess.run(["cp", "-a", toolchain, root / "usr/local/rust"], check=True)
    stage.environment["PATH"] = f"/usr/local/rust/bin:{PATH}"
    stage.run(OF_RUST_IMAGE)
    # The authorities of this machine, in place of those of the package.
    shutil.copy("/etc/ssl/certs/ca-certificates.crt", root / "etc/ssl/certs/ca-certificates.crt")
    stage.replay(steps, None)
    return root / "build/target/release/relume"


@contextmanager
def proc(stage):
    """Mounts /proc in the root of a stage, as container engines do."""
    place = stage.root / "proc"
    subprocess.run(["mount", "-t", "proc", "proc", place], check=True)
    try:
        yield
    finally:
        subprocess.run(["umount", "--lazy", place], check=True)


def wait_for(ready, limit, what):
    until = time.monotonic() + limit
    while not ready():
        if time.monotonic() > until:
            raise SystemExit(f"{what} within {limit} s")
        time.sleep(0.1)


def use(stage, name):
    """Uses the service of an image as its callers do."""
    with socket.socket() as free:
        free.bind(("127.0.0.1", 0))
        address = f"127.0.0.1:{free.getsockname()[1]}"
    environment = stage.environment | {"RELUME_LISTEN": address.replace("127.0.0.1", "0.0.0.0")}
    said = subprocess.run(stage.command("--version"), env=environment, capture_output=True, text=True, check=True).stdout
    without_key = subprocess.run(stage.command(), env=environment, capture_output=True, text=True, timeout=START_LIMIT)
    if without_key.returncode == 0 or "key" not in without_key.stderr:
        raise SystemExit(f"{name}: the server starts without a key on all addresses: {without_key.stderr}")
    environment["RELUME_API_KEYS"] = KEY

    def is_healthy():
        return subprocess.run(stage.health_check(), env=environment, capture_output=True).returncode == 0

    if is_healthy():
        raise SystemExit(f"control: {name} is healthy without a server")
    server = subprocess.Popen(stage.command(), env=environment, stdout=subprocess.DEVNULL, stderr=subprocess.PIPE, text=True)
    try:
        wait_for(lambda: server.poll() is not None or is_healthy(), START_LIMIT, f"{name}: the server is not healthy")
        if server.poll() is not None:
            raise SystemExit(f"{name}: the server ends at its start: {server.stderr.read()}")
        server.send_signal(getattr(signal, stage.last["STOPSIGNAL"]))
        code = server.wait(END_LIMIT)
    finally:
        server.kill()
    if code != 0:
        raise SystemExit(f"{name}: the server ends with {code}: {server.stderr.read()}")
    if not (stage.root / "data/relume.db").is_file():
        raise SystemExit(f"{name}: no database in the volume /data")
    print(f"{name}: {said.split(chr(10))[0]}, healthy as user {stage.last['USER']}, ended on {stage.last['STOPSIGNAL']}")


def main():
    dockerfile, base, root, program = (pathlib.Path(argument).resolve() for argument in sys.argv[1:5])
    build, last = stages(dockerfile.read_text())
    if os.environ.get("RELUME_IMAGES_BUILD"):
        program = built_program(build, base, root.with_name(f"{root.name}-build"))
    stage = Stage(base, root)
    stage.replay(last, program)
    # The program also works without /proc, which some sandboxes do not have.
    use(stage, f"{dockerfile.name}, without /proc")
    shutil.rmtree(stage.root / "data")
    (stage.root / "data").mkdir()
    os.chown(stage.root / "data", *(int(id) for id in stage.last["USER"].split(":")))
    with proc(stage):
        use(stage, dockerfile.name)


if __name__ == "__main__":
    main()
