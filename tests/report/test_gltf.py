# SPDX-License-Identifier: MIT
import base64
import io
import json

import numpy as np
from PIL import Image

from pinwm_drake.report.gltf import Sheet, gltf_text, rectangle


def array(document: dict, number: int) -> np.ndarray:
    entry = document["accessors"][number]
    view = document["bufferViews"][entry["bufferView"]]
    data = base64.b64decode(document["buffers"][0]["uri"].split(",")[1])
    kind = {5126: "<f4", 5125: "<u4"}[entry["componentType"]]
    values = np.frombuffer(data[view["byteOffset"] :][: view["byteLength"]], kind)
    size = 1 if entry["type"] == "SCALAR" else int(entry["type"][3:])
    assert len(values) == entry["count"] * size
    values = values.reshape(-1, size)
    np.testing.assert_array_equal(values.min(axis=0), np.float32(entry["min"]))
    np.testing.assert_array_equal(values.max(axis=0), np.float32(entry["max"]))
    return values


def test_a_file_holds_corners_colours_and_textures():
    picture = np.random.default_rng(0).integers(0, 255, (3, 5, 4)).astype(np.uint8)
    colours = np.random.default_rng(1).uniform(size=(3, 3))
    plain = Sheet(np.eye(3), np.array([[0, 1, 2]]), colours)
    document = json.loads(gltf_text([plain, rectangle(0.5, 0.3, picture, sharp=True)]))
    first, second = document["meshes"][0]["primitives"]
    # glTF's y is up where Drake's z is.
    np.testing.assert_array_equal(array(document, first["attributes"]["POSITION"]), [[1, 0, 0], [0, 0, -1], [0, 1, 0]])
    np.testing.assert_allclose(array(document, first["attributes"]["COLOR_0"]), colours, atol=1e-7)
    np.testing.assert_array_equal(array(document, first["indices"])[:, 0], [0, 1, 2])
    materials = document["materials"]
    assert [materials[part["material"]]["alphaMode"] for part in (first, second)] == ["OPAQUE", "BLEND"]
    assert "baseColorTexture" not in materials[0]["pbrMetallicRoughness"]
    texture = document["textures"][materials[1]["pbrMetallicRoughness"]["baseColorTexture"]["index"]]
    stored = document["images"][texture["source"]]["uri"].split(",")[1]
    np.testing.assert_array_equal(np.asarray(Image.open(io.BytesIO(base64.b64decode(stored)))), picture)
    # The picture's upper left corner is at -x, +y of the sheet.
    corners, uv = (array(document, second["attributes"][name]) for name in ("POSITION", "TEXCOORD_0"))
    corner = int(np.flatnonzero((uv == 0).all(axis=1))[0])
    np.testing.assert_allclose(corners[corner], [-0.25, 0, -0.15], atol=1e-7)
    # Its faces look towards +z, which is glTF's +y.
    a, b, c = corners[array(document, second["indices"])[:3, 0]]
    assert np.cross(b - a, c - a)[1] > 0
