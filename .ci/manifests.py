"""manifests.py PROGRAM: checks the Kubernetes files in deploy/.

Helm's library lints the chart. The rendered objects and the plain manifests must match the schemas of the Kubernetes API (strict mode).
Objects of Kueue and KEDA must match kueue-keda.schema.json beside this file; `.ci/schedulers` also validates KEDA's objects with an npm
package. PROGRAM must accept the options and variables that the files give it. Each check has a control that it must refuse."""

import copy
import pathlib
import re
import subprocess
import sys

import helm_python as helm
import jsonschema
import kubernetes_validate
import yaml

ROOT = pathlib.Path(__file__).resolve().parent.parent
CHART = str(ROOT / "deploy/helm/relume")
SCHEMAS = yaml.safe_load((ROOT / ".ci/kueue-keda.schema.json").read_text())
# Values for the renderings of the chart: the defaults, all options, and a server without workers.
VALUES = {
    "defaults": {},
    "all": {
        "image": {"repository": "images.example/relume", "tag": "gpu"},
        "imagePullSecrets": [{"name": "pull"}],
        "database": {"secret": "relume-database"},
        "artifacts": {"url": "s3://bucket/relume", "secret": "relume-s3", "endpoint": "http://s3:9000", "allowHttp": True},
        "server": {
            "device": "gpu",
            "trains": True,
            "gpus": 1,
            "env": [{"name": "RELUME_KEEP_JOBS", "value": "30"}],
            "nodeSelector": {"pool": "gpu"},
            "tolerations": [{"key": "gpu", "operator": "Exists"}],
        },
        "service": {"type": "NodePort", "port": 80},
        "volume": {"size": "1Ti", "storageClass": "fast"},
        "workers": {
            "mode": "job",
            "count": 4,
            "gpus": 1,
            "labels": ["gpu", "night"],
            "env": [{"name": "RUST_LOG", "value": "debug"}],
            "nodeSelector": {"pool": "gpu"},
            "tolerations": [{"key": "gpu", "operator": "Exists"}],
        },
    },
    "alone": {"server": {"trains": True}, "workers": {"mode": "none"}, "volume": {"existingClaim": "models"}},
}
WRONG_VALUES = [
    {"workers": {"mode": "deploy"}},
    {"worker": {"count": 1}},
    {"workers": {"terminationGracePeriodSeconds": 30}},
    {"artifacts": {"url": "bucket"}},
    {"keys": {"secret": ""}},
]


def built_in(manifest):
    kubernetes_validate.validate(manifest, kubernetes_validate.latest_version(), strict=True)


def fault(manifest):
    """The error of one object, or None."""
    kind = f"{manifest['apiVersion']} {manifest['kind']}"
    try:
        if kind in SCHEMAS:
            jsonschema.validate(manifest, SCHEMAS[kind])
            if manifest["kind"] == "ScaledJob":
                spec = manifest["spec"]["jobTargetRef"]
                built_in({"apiVersion": "batch/v1", "kind": "Job", "metadata": {}, "spec": spec})
        else:
            built_in(manifest)
    except (jsonschema.ValidationError, kubernetes_validate.ValidationError) as error:
        return f"{kind}: {error.message}"
    return None


def objects(text):
    return [document for document in yaml.safe_load_all(text) if document]


def rendered(chart):
    """Yields each object of each rendering of the chart, with its file and rendering."""
    for name, values in VALUES.items():
        chart.validate_schema(values)
        for file, text in chart.render(values, name="relume", namespace="studio").items():
            if not file.endswith(".txt"):
                yield from ((f"{file} ({name})", item) for item in objects(text))


def plain():
    for file in sorted((ROOT / "deploy/kubernetes").glob("*.yaml")):
        yield from ((file.name, item) for item in objects(file.read_text()))


def commands(found):
    """The arguments of the program in each manifest and Compose service, with the names of the environment variables set there."""
    specs = [item.get("spec", {}) for _, item in found]
    specs = [spec.get("jobTargetRef", spec) for spec in specs]
    pods = [spec["template"]["spec"] for spec in specs if "template" in spec]
    services = yaml.safe_load((ROOT / "deploy/compose.yaml").read_text())["services"]
    given = [
        (container["args"], [variable["name"] for variable in container["env"]])
        for pod in pods
        for container in pod["containers"]
    ]
    ours = [service for service in services.values() if "RELUME_IMAGE" in service["image"]]
    return given + [(service["command"], [*service["environment"]]) for service in ours]


def unknown(program, arguments, variables):
    """The error if the program lacks an option or a variable, or None. `--help` parses all arguments first and names the variables."""
    ended = subprocess.run([program, *arguments, "--help"], capture_output=True, text=True)
    if ended.returncode != 0:
        return f"{' '.join(arguments)}: {ended.stderr.strip()}"
    named = set(re.findall(r"\bRELUME_[A-Z_]+", ended.stdout))
    missing = [name for name in variables if name.startswith("RELUME_") and name not in named]
    return f"{' '.join(arguments)}: the help does not name {missing}" if missing else None


def broken(item):
    """A copy of the object with an unknown field in its spec."""
    item = copy.deepcopy(item)
    item.get("spec", item)["replicsa"] = 1
    return item


def main():
    findings = helm.lint(CHART)
    wrong = [str(message) for message in findings["messages"] if message["severity"] > 1] + findings["errors"]
    with helm.Chart.load(CHART) as chart:
        found = [*rendered(chart), *plain()]
        for values in WRONG_VALUES:
            try:
                chart.validate_schema(values)
                wrong.append(f"control failed: values.schema.json accepts {values}")
            except helm.HelmValuesError:
                pass
    for name, item in found:
        if error := fault(item):
            wrong.append(f"{name}: {error}")
        if not fault(broken(item)):
            wrong.append(f"{name}: control failed: this check does not detect an unknown field of {item['kind']}")
    scaled = next(item for _, item in found if item["kind"] == "ScaledJob")
    scaled["spec"]["jobTargetRef"]["template"]["spec"]["containers"][0]["arsg"] = []
    if not fault(scaled):
        wrong.append("control failed: this check does not detect an unknown field of a ScaledJob's pod")
    given = commands(found)
    wrong += filter(None, (unknown(sys.argv[1], *command) for command in given))
    arguments, variables = given[0]
    for control in [([*arguments, "--no-such-option"], variables), (arguments, [*variables, "RELUME_NO_SUCH_VARIABLE"])]:
        if not unknown(sys.argv[1], *control):
            wrong.append("control failed: this check does not detect an option or a variable that the program lacks")
    if wrong:
        sys.exit("\n".join(wrong))
    print(f"{len(found)} objects of the chart and of deploy/kubernetes match the schemas of Kubernetes, Kueue and KEDA, "
          f"and the program accepts {len(given)} command lines")


main()
