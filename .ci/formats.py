"""Validates USD files with NVIDIA's rule for splats, and checks that OpenUSD reads the model's attributes."""

import json
import pathlib
import subprocess
import sys

from pxr import Usd, UsdGeom

RULE = "com.nvidia.usd.VG.035"


def validated(validator, file):
    """The report of the rule for a file."""
    report = pathlib.Path("report.json")
    report.unlink(missing_ok=True)
    subprocess.run([validator, "-d", "--requirement", RULE, "--json-output", report, file], capture_output=True)
    return json.loads(report.read_text())


def check(file):
    stage = Usd.Stage.Open(str(file))
    prim = stage.GetDefaultPrim()
    assert prim.GetTypeName() == "ParticleField3DGaussianSplat", prim.GetTypeName()
    assert UsdGeom.GetStageUpAxis(stage) == "Y"
    count = len(prim.GetAttribute("positions").Get())
    degree = prim.GetAttribute("radiance:sphericalHarmonicsDegree").Get()
    assert count > 100
    assert len(prim.GetAttribute("radiance:sphericalHarmonicsCoefficients").Get()) == count * (degree + 1) ** 2
    primvars = UsdGeom.PrimvarsAPI(prim)
    for name in ("diffuseColor", "roughness", "metallic", "normals", "displayColor"):
        primvar = primvars.GetPrimvar(name)
        assert primvar.GetInterpolation() == "vertex" and len(primvar.Get()) == count, name


def main(validator, *files):
    for file in files:
        check(file)
        report = validated(validator, file)
        assert report["status"] == "PASS", f"{file}: {report}"
    # Controls: each of these errors must be detected.
    text = pathlib.Path(files[0]).read_text()
    for before, after in (
        ('interpolation = "vertex"', 'interpolation = "constant"'),
        ("float[] opacities = [", "float[] opacities = [0.5, "),
        ("float[] opacities = [", "float[] opacities = [1.5, "),
        ("float3[] extent", "float3[] extents"),
    ):
        assert before in text, before
        pathlib.Path("wrong.usda").write_text(text.replace(before, after, 1))
        assert validated(validator, "wrong.usda")["status"] == "FAIL", f"control failed: this check does not detect {after}"
    print("the .usda and .usdz files are valid")


main(*sys.argv[1:])
