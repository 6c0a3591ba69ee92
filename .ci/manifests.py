"""deploy/ for Kubernetes: the chart by Helm's own library, what it renders and the plain manifests by the API's schemas, strictly.

Kueue's and KEDA's objects are held to kueue-keda.schema.json beside this file; `.ci/schedulers` also asks a package of KEDA's types.
The program, which is given as argument, is asked whether it knows its options. Each check has to refuse something that is wrong."""

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
# What the chart is rendered with: its defaults, everything it can do, and no workers.
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
    """None, or what is wrong with one object."""
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
    """Each object of each rendering of the chart, with where it is from."""
    for name, values in VALUES.items():
        chart.validate_schema(values)
        for file, text in chart.render(values, name="relume", namespace="studio").items():
            if not file.endswith(".txt"):
                yield from ((f"{file} ({name})", item) for item in objects(text))


def plain():
    for file in sorted((ROOT / "deploy/kubernetes").glob("*.yaml")):
        yield from ((file.name, item) for item in objects(file.read_text()))


def commands(found):
    """The arguments that the program is given anywhere in deploy/, and the names of the variables beside them."""
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
    """None, or what the program does not know. It reads all arguments before it shows its help, which names its variables."""
    ended = subprocess.run([program, *arguments, "--help"], capture_output=True, text=True)
    if ended.returncode != 0:
        return f"{' '.join(arguments)}: {ended.stderr.strip()}"
    named = set(re.findall(r"\bRELUME_[A-Z_]+", ended.stdout))
    missing = [name for name in variables if name.startswith("RELUME_") and name not in named]
    return f"{' '.join(arguments)}: the help does not name {missing}" if missing else None


def broken(item):
    """The same with a wrong field where its kind keeps its settings."""
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
                wrong.append(f"values.schema.json takes {values}: the check is of no use")
            except helm.HelmValuesError:
                pass
    for name, item in found:
        if error := fault(item):
            wrong.append(f"{name}: {error}")
        if not fault(broken(item)):
            wrong.append(f"{name}: a wrong field of {item['kind']} was not seen: the check is of no use")
    scaled = next(item for _, item in found if item["kind"] == "ScaledJob")
    scaled["spec"]["jobTargetRef"]["template"]["spec"]["containers"][0]["arsg"] = []
    if not fault(scaled):
        wrong.append("a wrong field of a scaled job's pod was not seen: the check is of no use")
    given = commands(found)
    wrong += filter(None, (unknown(sys.argv[1], *command) for command in given))
    arguments, variables = given[0]
    for control in [([*arguments, "--no-such-option"], variables), (arguments, [*variables, "RELUME_NO_SUCH_VARIABLE"])]:
        if not unknown(sys.argv[1], *control):
            wrong.append("an option or a variable that the program does not have was not seen: the check is of no use")
    if wrong:
        sys.exit("\n".join(wrong))
    print(f"{len(found)} objects of the chart and of deploy/kubernetes are what Kubernetes, Kueue and KEDA take, "
          f"and {len(given)} command lines what the program takes")


main()
