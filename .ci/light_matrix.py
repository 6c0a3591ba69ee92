"""Adds the parts of a light matrix, read with OpenImageIO, with the weights of `relume weights`, and compares the sum with a frame
under the same light. Arguments: the matrix, the JSON of the weights, the frame."""

import json
import sys

import numpy as np
import OpenImageIO as oiio


def parts(path):
    """The specification and the pixels of each part."""
    image = oiio.ImageInput.open(path)
    assert image, f"{path}: {oiio.geterror()}"
    found = []
    while image.seek_subimage(len(found), 0):
        found.append((image.spec(), image.read_image(len(found), 0, 0, image.spec().nchannels, "float")))
    image.close()
    return found


def main(matrix, weights, frame):
    (coverage, alpha), *lights = parts(matrix)
    assert coverage["oiio:subimagename"] == "alpha" and coverage.channelnames == ("A",), coverage.channelnames
    factors = {part["part"]: np.array(part["rgb"]) for part in json.load(open(weights))["parts"]}
    assert len(factors) == len(lights) > 2, (len(factors), len(lights))
    total, reversed_total = 0.0, 0.0
    for (spec, pixels), other in zip(lights, reversed(factors.values())):
        name = spec["oiio:subimagename"]
        assert set(spec.channelnames) == {f"{name}.{c}" for c in "RGB"}, spec.channelnames
        assert spec["colorInteropID"] == "lin_rec709_scene" and spec["compression"] == "zip", name
        assert abs(np.linalg.norm(spec["relume:direction"]) - 1.0) < 1e-5 and spec["relume:weight"], name
        assert ("relume:solid_angle_sr" in spec.extra_attribs) == name.startswith("lobe"), name
        order = [spec.channelnames.index(f"{name}.{c}") for c in "RGB"]
        total = total + pixels[..., order] * factors[name]
        reversed_total = reversed_total + pixels[..., order] * other
    expected = parts(frame)[0][1]
    assert np.allclose(alpha[..., 0], expected[..., 3], atol=1e-3), "the coverage differs from the alpha of the frame"

    def apart(x): return float(np.linalg.norm(x - expected[..., :3]) / np.linalg.norm(expected[..., :3]))
    assert apart(total) < 0.2, f"the sum differs from the frame by {apart(total)}"
    assert apart(reversed_total) > 2 * apart(total), f"control failed: other weights differ by {apart(reversed_total)} only"


main(*sys.argv[1:])
