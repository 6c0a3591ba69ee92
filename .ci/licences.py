"""licences.py FILE: writes the licences of the Rust crates and npm packages in the program."""

import hashlib
import json
import pathlib
import re
import subprocess
import sys

TARGETS = ["x86_64-unknown-linux-gnu", "aarch64-unknown-linux-gnu", "aarch64-apple-darwin"]
TEXT = re.compile(r"(un)?licen[cs]e|copying|copyright|notice|swagger-ui-es-bundle.js.LICENSE", re.IGNORECASE)
# The npm packages that web/dist contains.
NPM = ["js-base64", "preact", "querystringify", "requires-port", "swagger-ui-dist", "tus-js-client", "url-parse"]


def crates():
    """Name, version, licence and folder of each crate that the program contains on some target."""
    metadata = json.loads(run("cargo", "metadata", "--format-version", "1", "--locked"))
    known = {(package["name"], package["version"]): package for package in metadata["packages"]}
    there = set()
    for target in TARGETS:
        tree = run("cargo", "tree", "--locked", "-p", "relume", "--edges", "normal", "--target", target, "--prefix", "none", "--format", "{p}")
        there |= {tuple(line.split()[:2]) for line in tree.splitlines() if line}
    for name, version in sorted(there):
        package = known[name, version.removeprefix("v")]
        if package["source"]:
            licence = package["license"] or f"file {package['license_file']}"
            yield name, package["version"], licence, pathlib.Path(package["manifest_path"]).parent


def modules():
    """As crates(), for the npm packages."""
    modules = pathlib.Path("web/node_modules")
    for name in NPM:
        package = json.loads((modules / name / "package.json").read_text())
        yield name, package["version"], package["license"], modules / name


def run(*command):
    return subprocess.run(command, capture_output=True, text=True, check=True).stdout


def collected():
    packages = [("crate", *one) for one in crates()] + [("npm", *one) for one in modules()]
    texts = {}
    lines = ["Relume contains the following packages, under these licences. The texts of the licences follow the list.", ""]
    for kind, name, version, licence, folder in packages:
        numbers = []
        for path in sorted(path for path in folder.iterdir() if path.is_file() and TEXT.match(path.name)):
            text = "\n".join(line.rstrip() for line in path.read_text(errors="replace").strip().splitlines())
            key = hashlib.sha256(" ".join(text.split()).encode()).hexdigest()
            number = texts.setdefault(key, (len(texts) + 1, text))[0]
            numbers.append(str(number))
        told = f"texts {', '.join(dict.fromkeys(numbers))}" if numbers else "the standard text; the package has none"
        lines.append(f"{kind} {name} {version}: {licence} ({told})")
    for number, text in texts.values():
        lines += ["", "=" * 100, f"Text {number}", "", text]
    return "\n".join(lines) + "\n"


def main():
    text = collected()
    pathlib.Path(sys.argv[1]).write_text(text)
    crates, modules = text.count("\ncrate "), text.count("\nnpm ")
    if crates < 100 or modules < len(NPM):
        sys.exit(f"only {crates} crates and {modules} npm packages were found")
    print(f"{sys.argv[1]}: {crates} crates, {modules} npm packages, {len(text) // 1000} kB")


if __name__ == "__main__":
    main()
