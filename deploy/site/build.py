"""build.py RELUME OUT [VERSION]: makes the documentation site in OUT/site/VERSION from the texts of the repository.

RELUME is the program, whose --help completes the page of the command line. openapi/openapi.json completes the page of the API. Links to
files that the site does not contain, such as sources, become plain text. MkDocs fails on a link or an anchor that leads nowhere.
Equations are typeset by KaTeX, which npm installs (equations.py).

VERSION is MAJOR.MINOR; omitted: that of Cargo.toml. Other versions in OUT/site stay. OUT/site/versions.json lists all, newest first, as the
version selector of Material for MkDocs reads it. OUT/site/latest is a symbolic link to the newest version, and OUT/site/index.html leads there.
"""

import json
import os
import pathlib
import re
import shutil
import subprocess
import sys

ROOT = pathlib.Path(__file__).resolve().parents[2]
HERE = pathlib.Path(__file__).resolve().parent
# Pages with many words of every kind, which a search lists last.
LAST = ("CHANGELOG.md", "docs/decisions/", "docs/results.md", "docs/promises.md")
# Texts beside docs/ that are pages.
TEXTS = [
    "CHANGELOG.md", "CONTRIBUTING.md", "SECURITY.md", "CODE_OF_CONDUCT.md", "deploy/README.md", "clients/python/README.md",
    "examples/pipeline/README.md", "examples/embed/README.md",
]
# Comments for `.ci/examples`.
COMMENT = re.compile(r"^<!-- examples: .* -->\n", re.MULTILINE)
# Code blocks, each after a line with its label in bold; several in succession become tabs.
LABELLED = r"\*\*[^*\n]+\*\*\n\n```\w+\n(?:(?!```).*\n)*```\n"
TABS = re.compile(rf"^{LABELLED}(?:\n{LABELLED})+", re.MULTILINE)
VERSION = re.compile(r"\d+\.\d+")
LINK = re.compile(r"(!?)\[((?:[^\[\]]|\[[^\]]*\])*)\]\(([^()\s]+)\)")


def pages():
    """The pages by their path in the repository, each with its path in the site."""
    found = {str(path.relative_to(ROOT)): str(path.relative_to(ROOT)) for path in sorted((ROOT / "docs").rglob("*.md"))}
    return found | {text: text for text in ["README.md", *TEXTS]}


def relinked(text, source, known):
    """The text of a page with links that lead to pages of the site."""

    def replaced(match):
        image, label, target = match.groups()
        if re.match(r"[a-z]+:|#", target):
            return match[0]
        path, _, anchor = target.partition("#")
        path = os.path.normpath(os.path.join(os.path.dirname(source), path))
        if (ROOT / path).is_dir() and f"{path}/README.md" in known:
            path += "/README.md"
        if path not in known:
            return match[0] if image else label
        to = os.path.relpath(known[path], os.path.dirname(known[source]) or ".")
        return f"{image}[{label}]({to}{'#' + anchor if anchor else ''})"

    # Code keeps its brackets.
    parts = re.split(r"(^```.*?^```)", text, flags=re.MULTILINE | re.DOTALL)
    return "".join(part if i % 2 else LINK.sub(replaced, part) for i, part in enumerate(parts))


def tabbed(text):
    """The text of a page with tabs in place of labelled code blocks that follow each other."""

    def tabs(match):
        label = re.compile(r"^\*\*([^*\n]+)\*\*$")
        lines = (label.sub(r'=== "\1"', line) if label.match(line) else f"    {line}".rstrip() for line in match[0].splitlines())
        return "\n".join(lines) + "\n"

    return TABS.sub(tabs, COMMENT.sub("", text))


def help_of(program, command):
    """The help of a command, and that of its subcommands."""
    text = subprocess.run([program, *command, "--help"], capture_output=True, text=True, check=True).stdout
    yield command, text
    listed = re.search(r"^Commands:\n((?:  .*\n|\n)+)", text, re.MULTILINE)
    for name in re.findall(r"^  (\w[\w-]*)", listed[1] if listed else "", re.MULTILINE):
        if name != "help":
            yield from help_of(program, [*command, name])


def command_line(program):
    lines = [(HERE / "cli.md").read_text()]
    for command, text in help_of(program, []):
        lines += [f"## {' '.join(['relume', *command])}", "", "```text", text.rstrip(), "```", ""]
    return "\n".join(lines)


def api(description):
    """The operations by their tags, and the place of everything else."""
    lines = [(HERE / "api.md").read_text(), description["info"].get("description", ""), ""]
    by_tag = {}
    for path, item in description["paths"].items():
        for method, operation in item.items():
            if "responses" in operation:
                by_tag.setdefault((operation.get("tags") or ["other"])[0], []).append((method.upper(), path, operation))
    for tag, operations in by_tag.items():
        lines += [f"## {tag}", ""]
        for method, path, operation in operations:
            lines += [f"### {operation.get('summary', operation['operationId'])}", "", f"`{method} {path}`", "", operation.get("description", ""), ""]
            fields = [(field["name"], field["in"], field.get("description", "")) for field in operation.get("parameters", [])]
            if fields:
                lines += ["| parameter | in | content |", "|---|---|---|"]
                lines += [f"| `{name}` | {place} | {' '.join(text.split()).replace('|', chr(92) + '|')} |" for name, place, text in fields] + [""]
            answers = "; ".join(f"{status}: {answer.get('description') or 'OK'}" for status, answer in operation["responses"].items())
            lines += [f"Answers: {' '.join(answers.split())}", ""]
    return "\n".join(lines)


def install_katex(out, content):
    """Installs KaTeX, which typesets the equations, in `out`/katex, and copies its style sheet and fonts to the site."""
    folder = out / "katex"
    folder.mkdir(parents=True, exist_ok=True)
    for name in ("package.json", "package-lock.json"):
        shutil.copyfile(HERE / name, folder / name)
    try:
        subprocess.run(["npm", "ci", "--loglevel=error", "--no-audit", "--no-fund", "--ignore-scripts"], cwd=folder, check=True)
    except (OSError, subprocess.CalledProcessError) as error:
        sys.exit(f"cannot install KaTeX, which typesets the equations; npm and its package registry are necessary ({error})")
    package = folder / "node_modules/katex"
    # Browsers load WOFF2, the first of the formats; the site omits the others.
    style = re.sub(r',url\(fonts/[^)]+\) format\("(?:woff|truetype)"\)', "", (package / "dist/katex.min.css").read_text())
    (content / "katex/fonts").mkdir(parents=True, exist_ok=True)
    (content / "katex/katex.min.css").write_text(style)
    shutil.copyfile(package / "LICENSE", content / "katex/LICENSE")
    for font in (package / "dist/fonts").glob("*.woff2"):
        shutil.copyfile(font, content / "katex/fonts" / font.name)
    shutil.copyfile(HERE / "equations.css", content / "equations.css")


def this_version():
    """Major and minor version of Cargo.toml."""
    return re.search(r'^version = "(\d+\.\d+)', (ROOT / "Cargo.toml").read_text(), re.MULTILINE)[1]


def list_versions(site):
    """Writes the list of the versions in `site`, its link to the newest and its first page."""
    found = [place.parent.name for place in site.glob("*/index.html") if VERSION.fullmatch(place.parent.name) and not place.parent.is_symlink()]
    found.sort(key=lambda version: [int(part) for part in version.split(".")], reverse=True)
    listed = [{"version": version, "title": version, "aliases": ["latest"] if version == found[0] else []} for version in found]
    (site / "versions.json").write_text(json.dumps(listed, indent=1) + "\n")
    latest = site / "latest"
    latest.unlink(missing_ok=True)
    latest.symlink_to(found[0])
    shutil.copyfile(HERE / "index.html", site / "index.html")


def main():
    program, out = sys.argv[1], pathlib.Path(sys.argv[2]).resolve()
    version = sys.argv[3] if len(sys.argv) > 3 else this_version()
    if not VERSION.fullmatch(version):
        sys.exit(f"the version {version} is not MAJOR.MINOR")
    content = out / "pages"
    shutil.rmtree(content, ignore_errors=True)
    known = pages()
    assets = {str(path.relative_to(ROOT)) for path in (ROOT / "docs").rglob("*") if path.suffix in (".png", ".svg", ".json", ".webp")}
    for source in assets:
        (content / source).parent.mkdir(parents=True, exist_ok=True)
        shutil.copyfile(ROOT / source, content / source)
    known |= {asset: asset for asset in assets}
    for source, place in pages().items():
        (content / place).parent.mkdir(parents=True, exist_ok=True)
        text = tabbed(relinked((ROOT / source).read_text(), source, known))
        rank = "---\nsearch:\n  boost: 0.2\n---\n\n" if source.startswith(LAST) else ""
        (content / place).write_text(rank + text)
    install_katex(out, content)
    description = json.loads((ROOT / "openapi/openapi.json").read_text())
    shutil.copyfile(ROOT / "openapi/openapi.json", content / "openapi.json")
    (content / "cli.md").write_text(command_line(program))
    (content / "api.md").write_text(api(description))
    decisions = sorted(str(path.relative_to(ROOT)) for path in (ROOT / "docs/decisions").glob("0*.md"))
    listed = json.dumps(["docs/decisions/README.md", *decisions])
    settings = (HERE / "mkdocs.yml").read_text().replace("DECISIONS", listed).replace("VERSION", version)
    settings = settings.replace("HOOK", json.dumps(str(HERE / "equations.py")))
    (out / "mkdocs.yml").write_text(settings)
    subprocess.run([sys.executable, "-m", "mkdocs", "build", "--config-file", out / "mkdocs.yml"], check=True)
    list_versions(out / "site")


if __name__ == "__main__":
    main()
