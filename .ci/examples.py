"""examples.py FOLDER: runs the code blocks of the documentation against the server of RELUME_SERVER, with the key of RELUME_API_KEY.

An HTML comment in a page, which readers do not see, says what becomes of the blocks after it, up to the next such comment:

- `<!-- examples: setup -->`: shell; runs before each sequence of the page.
- `<!-- examples: sequence -->`: the blocks of each language are one program. The page states the pictures that it writes, as in
  "`a.png`, 256 x 256 pixels" or "`a.zip`, 6 pictures of 320 x 240 pixels". Afterwards the server must have no captures and models.
- `<!-- examples: commands -->`: shell commands with placeholders, or Python. The comment of a command names the fields of its answer that later
  commands use, as in `# {"id": "JOB", ...}`, and the statuses of an expected refusal, as in `# 409 lists the jobs`.
- `<!-- examples: not run: REASON -->`: does not run.

A block without such a comment is an error. `commands` are shortened as SHORTER states. Python can use the folder `thing`, an unpacked capture.
"""

import collections
import json
import os
import pathlib
import re
import subprocess
import sys
import time
import urllib.request
import zipfile

from PIL import Image

ROOT = pathlib.Path(__file__).resolve().parents[1]
SEQUENCES = "docs/guide/first-calls.md"
PAGES = [SEQUENCES, "README.md", "docs/guide/service.md", "docs/guide/python.md"]
LANGUAGES = ("sh", "python", "ts")
SERVER, KEY = os.environ["RELUME_SERVER"], os.environ["RELUME_API_KEY"]
# What `commands` say, and what runs in its place: shorter work, and the server of the check.
FEW_STEPS = {"iterations": 60, "max_gaussians": 1500}
SHORTER = [
    ('"preset": "draft"', f'"preset": "draft", "overrides": {json.dumps(FEW_STEPS)}'),
    ('.train("draft")', f'.train("draft", overrides={FEW_STEPS})'),
    ('"frames": 120', '"frames": 4'),
    ("relume.Client()", f'relume.Client("{SERVER}")'),
    ("localhost:7878", SERVER),
]
# Seconds that one program or command may take, and that an export may take.
LIMIT, EXPORT_LIMIT = 300, 60
Block = collections.namedtuple("Block", "page line language code mark reason")
Answer = collections.namedtuple("Answer", "ok output")


class Fault(Exception):
    """A sentence that says which block failed, and how."""


def blocks(page, text):
    """The code blocks of a page in the known languages, in their order."""
    mark, reason, language, found = None, "", None, []
    for number, line in enumerate(text.splitlines(), 1):
        comment = re.fullmatch(r"<!-- examples: (setup|sequence|commands|not run: (.+)) -->", line)
        if language is None and comment:
            mark, reason = comment[1].split(":")[0], comment[2] or ""
        elif language is None and line.startswith("```"):
            language, first, code = line[3:].strip(), number + 1, []
        elif language is not None and line.startswith("```"):
            if language in LANGUAGES and mark is None:
                raise Fault(f"{page}:{first}: no comment says whether this block runs (see .ci/examples.py)")
            if language in LANGUAGES:
                found.append(Block(page, first, language, "\n".join(code) + "\n", mark, reason))
            language = None
        elif language is not None:
            code.append(line)
    return found


def run(command, folder, text=None):
    """The end of a command and what it wrote, both streams together."""
    done = subprocess.run(command, cwd=folder, input=text, stdout=subprocess.PIPE, stderr=subprocess.STDOUT, text=True, timeout=LIMIT)
    return Answer(done.returncode == 0, done.stdout)


def program(language, code, folder):
    """Runs the code of one language as one program."""
    if language == "sh":
        (folder / "blocks.sh").write_text(code)
        return run(["bash", "-euo", "pipefail", "blocks.sh"], folder)
    if language == "python":
        (folder / "blocks.py").write_text(code)
        return run([sys.executable, "blocks.py"], folder)
    (folder / "blocks.mts").write_text(code)
    types = ROOT / "web/node_modules/@types"
    options = ["--strict", "--target", "es2022", "--module", "nodenext", "--types", "node", "--typeRoots", types]
    compiled = run([ROOT / "web/node_modules/.bin/tsc", *options, "blocks.mts"], folder)
    return run(["node", "blocks.mjs"], folder) if compiled.ok else compiled


def sequence(all_blocks, language, folder, change=lambda code: code):
    """Runs the setup of a page and its sequence in one language. `change` makes the controls."""
    folder.mkdir()
    for block in all_blocks:
        if block.mark == "setup" and not (answer := run(["bash", "-euo", "pipefail", "-c", block.code], folder)).ok:
            raise Fault(f"{block.page}:{block.line}: the setup fails:\n{answer.output}")
    parts = [block.code for block in all_blocks if block.mark == "sequence" and block.language == language]
    return program(language, change("\n".join(parts)), folder)


def stated_pictures(text):
    """The files that a page states: name, number of pictures (None: the file is one) and their size."""
    for name, number, width, height in re.findall(r"`([\w-]+\.\w+)`,\s+(?:(\d+)\s+pictures\s+of\s+)?(\d+) x (\d+)\s+pixels", text):
        yield name, int(number) if number else None, (int(width), int(height))


def check_picture(file, name, size):
    """Fails unless a file is a picture of a size that shows something."""
    with Image.open(file) as picture:
        picture.load()
        if picture.size != size:
            raise Fault(f"{name} has {picture.size} pixels, not {size}")
        colours = picture.convert("RGB").resize((64, 64)).getcolors(4096)
    if colours is not None and len(colours) < 32:
        raise Fault(f"{name} has only {len(colours)} colours")


def check_pictures(stated, folder):
    for name, number, size in stated:
        if not (folder / name).is_file():
            raise Fault(f"{name} was not written")
        if number is None:
            check_picture(folder / name, name, size)
            continue
        with zipfile.ZipFile(folder / name) as archive:
            names = archive.namelist()
            if len(names) != number:
                raise Fault(f"{name} has {len(names)} files, not {number}")
            for one in names:
                with archive.open(one) as file:
                    check_picture(file, f"{name}/{one}", size)


def left_on_server():
    """What the server still has."""
    left = {}
    for what in ("captures", "models"):
        request = urllib.request.Request(f"{SERVER}/v1/{what}", headers={"Authorization": f"Bearer {KEY}"})
        with urllib.request.urlopen(request, timeout=LIMIT) as answer:
            left[what] = len(json.load(answer)["items"])
    return left


def sequences(all_blocks, text, folder):
    """Runs the sequence of each language of a page, and its controls."""
    stated = list(stated_pictures(text))
    if not stated:
        raise Fault(f"{SEQUENCES} states no picture")
    for language in LANGUAGES:
        begin = time.monotonic()
        place = folder / language
        answer = sequence(all_blocks, language, place)
        if not answer.ok:
            raise Fault(f"{SEQUENCES}: the blocks in {language} fail:\n{answer.output[-4000:]}")
        check_pictures(stated, place)
        if any(left_on_server().values()):
            raise Fault(f"{SEQUENCES}: the blocks in {language} leave {left_on_server()} on the server")
        print(f"  {language}: a sequence of {time.monotonic() - begin:.0f} s, {len(stated)} files with pictures", flush=True)
    name, number, (width, height) = stated[0]
    refused(lambda: check_pictures([(name, number, (width + 1, height))], folder / "sh"), "a picture of another size")
    refused(lambda: check_pictures([("missing.png", None, (width, height))], folder / "sh"), "a missing picture")
    paths = {"sh": "/v1/captures", "ts": "/v1/captures", "python": '"capture.zip"'}
    for language, path in paths.items():
        wrong = path.replace("captures", "nothing").replace("capture.zip", "nothing.zip")
        answer = sequence(all_blocks, language, folder / f"wrong-{language}", lambda code: code.replace(path, wrong))
        if answer.ok or not re.search("404|nothing.zip", answer.output):
            raise Fault(f"control: the blocks in {language} do not fail at the wrong path {wrong}:\n{answer.output[-2000:]}")


def refused(check, what):
    """The control of a check."""
    try:
        check()
    except Fault:
        return
    raise Fault(f"control: {what} is not noticed")


def commands(code):
    """The commands of a block with their comments. A backslash continues a line; the comments of all its lines count."""
    command, comment = "", ""
    for line in code.splitlines():
        part, _, told = re.sub(r"\s+#\s", "\0", line, count=1).partition("\0")
        comment = f"{comment} {told}".strip()
        command += part.rstrip()
        # An open quote continues a command, too.
        if command.endswith("\\"):
            command = command[:-1]
        elif command.count("'") % 2 == 0:
            if command:
                yield command, comment
            command, comment = "", ""


def shortened(code):
    for said, meant in SHORTER:
        code = code.replace(said, meant)
    return code


def placeholders(output, comment):
    """The placeholders that a comment names, with their values in the output of its command."""
    found = {}
    for field, name in re.findall(r'([\w-]+)"?:\s*["/\w]*?\b([A-Z]{3,})\b', comment):
        value = re.search(rf'^\s*{{.*?"{field}"\s*:\s*"([^"]+)"', output, re.DOTALL) or re.search(rf"(?mi)^{field}:.*/([^/\s]+)\s*$", output)
        if value:
            found[name] = value[1]
    return found


def shell_command(command, comment, folder):
    """Runs one command. A request for the file of an export is repeated until there is one."""
    tool = 'curl() { command curl --fail-with-body -sS -w "%{stderr}\\nstatus %{http_code}\\n" -H "Authorization: Bearer $RELUME_API_KEY" "$@"; }\n'
    until = time.monotonic() + EXPORT_LIMIT
    while True:
        answer = run(["bash", "-euo", "pipefail", "-c", tool + command], folder)
        status = re.search(r"^status (\d+)$", answer.output, re.MULTILINE)
        is_early = status and status[1] == "404" and re.search(r"/v1/exports/[^/]+/file", command)
        if not is_early or time.monotonic() > until:
            break
        time.sleep(0.5)
    is_expected = status and re.search(rf"\b{status[1]}\b", comment)
    return Answer(answer.ok or bool(is_expected), answer.output)


def shell_commands(block, folder, known):
    """Runs the commands of a block. `known` are the placeholders so far."""
    for command, comment in commands(block.code):
        if command.startswith("relume serve"):
            continue
        command = shortened(command)
        for name, value in known.items():
            command = re.sub(rf"\b{name}\b", value, command)
        answer = shell_command(command, comment, folder)
        if not answer.ok:
            raise Fault(f"{block.page}:{block.line}: this fails: {command}\n{answer.output[-2000:]}")
        known |= placeholders(answer.output, comment)
        if picture := re.search(r"-o (\S+\.png)", command):
            side = re.search(r"size=(\d+)", command)
            size = re.search(r'"width": (\d+), "height": (\d+)', command)
            with Image.open(folder / picture[1]) as written:
                stated = (int(side[1]),) * 2 if side else (int(size[1]), int(size[2])) if size else written.size
            check_picture(folder / picture[1], picture[1], stated)


def unpacked_capture(folder):
    """Makes the folder `thing`, a capture."""
    if not run(["relume", "sample", "sample.zip"], folder).ok:
        raise Fault("relume sample fails")
    with zipfile.ZipFile(folder / "sample.zip") as archive:
        archive.extractall(folder / "thing")


def page_commands(all_blocks, folder, change=lambda code: code):
    """Runs the blocks of a page that are `commands`, in their order."""
    folder.mkdir()
    known = {}
    for block in all_blocks:
        if block.mark != "commands":
            continue
        block = block._replace(code=change(block.code))
        if block.language == "sh":
            shell_commands(block, folder, known)
            continue
        unpacked_capture(folder)
        answer = program(block.language, shortened(block.code), folder)
        if not answer.ok:
            raise Fault(f"{block.page}:{block.line}: this block fails:\n{answer.output[-2000:]}")


def main():
    folder = pathlib.Path(sys.argv[1]).resolve()
    refused(lambda: blocks("a page", "```sh\ntrue\n```\n"), "a block without a comment")
    for page in PAGES:
        text = (ROOT / page).read_text()
        found = blocks(page, text)
        place = folder / page.replace("/", "-")
        if page == SEQUENCES:
            place.mkdir()
            sequences(found, text, place)
        else:
            page_commands(found, place)
        ran = [block for block in found if block.mark != "not run"]
        print(f"{page}: {len(ran)} blocks ran, {len(found) - len(ran)} did not", flush=True)
        for block in found:
            if block.mark == "not run":
                print(f"  line {block.line}, {block.language}: not run: {block.reason}")
        if not ran:
            raise Fault(f"{page}: no block ran")
    readme = blocks("README.md", (ROOT / "README.md").read_text())
    wrong = lambda code: code.replace("/thumbnail", "/nothing")
    refused(lambda: page_commands(readme, folder / "wrong", wrong), "a wrong path in README.md")
    print("the controls fail as they must")


if __name__ == "__main__":
    try:
        main()
    except Fault as fault:
        sys.exit(str(fault))
