"""Reads two EXR frames of one view with OpenImageIO: one float, premultiplied, Rec.709; one half, straight alpha, ACEScg."""

import sys

import numpy as np
import OpenImageIO as oiio

BEAUTY = ("R", "G", "B", "A", "albedo.R", "albedo.G", "albedo.B")
DATA = ("Z", "N.X", "N.Y", "N.Z", "roughness.Y")
# Primaries and white points of Rec.709 and AP1, CIE xy, from ITU-R BT.709 and SMPTE ST 2065-1 (ACEScg uses AP1).
REC709 = ((0.64, 0.33), (0.30, 0.60), (0.15, 0.06), (0.3127, 0.3290))
AP1 = ((0.713, 0.293), (0.165, 0.830), (0.128, 0.044), (0.32168, 0.33767))
# Cone response matrix of the Bradford chromatic adaptation.
BRADFORD = np.array([[0.8951, 0.2664, -0.1614], [-0.7502, 1.7135, 0.0367], [0.0389, -0.0685, 1.0296]])


def parts(path):
    """The specification and the pixels of each part."""
    image = oiio.ImageInput.open(path)
    assert image, f"{path}: {oiio.geterror()}"
    found = []
    while image.seek_subimage(len(found), 0):
        found.append((image.spec(), image.read_image(len(found), 0, 0, image.spec().nchannels, "float")))
    image.close()
    return found


def xyz(xy):
    return np.array([xy[0] / xy[1], 1.0, (1.0 - xy[0] - xy[1]) / xy[1]])


def to_xyz(primaries):
    columns = np.stack([xyz(xy) for xy in primaries[:3]], axis=1)
    return columns * np.linalg.solve(columns, xyz(primaries[3]))


def rec709_to_ap1():
    here, there = BRADFORD @ xyz(REC709[3]), BRADFORD @ xyz(AP1[3])
    adapt = np.linalg.inv(BRADFORD) @ np.diag(there / here) @ BRADFORD
    return np.linalg.inv(to_xyz(AP1)) @ adapt @ to_xyz(REC709)


def check_head(path, interop, rate):
    (beauty, _), (data, _) = parts(path)
    assert beauty.channelnames == BEAUTY and data.channelnames == DATA, (beauty.channelnames, data.channelnames)
    for spec, name, colours in ((beauty, "beauty", interop), (data, "data", "data")):
        assert spec["oiio:subimagename"] == name and spec["colorInteropID"] == colours, (path, name)
        assert spec["oiio:ColorSpace"] == colours, (path, name, spec["oiio:ColorSpace"])
        assert spec["compression"] == "zip" and spec["screenWindowWidth"] > 0
        matrix = np.array(spec["worldToCamera"]).reshape(4, 4)
        assert np.allclose(matrix[:3, :3] @ matrix[:3, :3].T, np.eye(3), atol=1e-5), "worldToCamera must be a rotation and a translation"
        assert (spec.get("framesPerSecond") == (24, 1)) == rate, (path, name)
    assert data.format == "float", "the data part must be float, whatever the colour depth"
    return beauty


def main(plain, graded):
    assert check_head(plain, "lin_rec709_scene", True).format == "float"
    spec = check_head(graded, "lin_ap1_scene", False)
    assert spec.format == "half"
    assert np.allclose(spec["chromaticities"], np.ravel(AP1), atol=1e-6)

    (_, a), (_, data) = parts(plain)
    (_, b), (_, again) = parts(graded)
    assert np.array_equal(data, again), "primaries and alpha must not change the data part"
    seen = a[..., 3] > 0.5
    assert seen.sum() > 100, "fewer than 100 pixels have alpha above 0.5"
    assert np.all(data[..., 0][seen] > 0) and np.allclose(np.linalg.norm(data[..., 1:4][seen], axis=1), 1, atol=0.01)

    expected = (a[..., :3][seen] / a[..., 3:4][seen]) @ rec709_to_ap1().T
    def apart(x): return float(np.max(np.abs(x - expected) / (np.abs(expected) + 0.01)))
    found, control = apart(b[..., :3][seen]), apart(a[..., :3][seen])
    assert found < 0.005, f"straight ACEScg colours differ from the expected ones by {found}"
    assert control > 0.05, f"control failed: premultiplied Rec.709 colours differ from the expected ones by only {control}"
    assert np.allclose(b[..., 4:7], a[..., 4:7] @ rec709_to_ap1().T, atol=0.002), "base colour must not be multiplied by alpha"


main(*sys.argv[1:])
