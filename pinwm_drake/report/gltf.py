# SPDX-License-Identifier: MIT
"""Unlit triangles in colours or with textures as glTF, which Drake's Meshcat shows; seen from both sides."""

import base64
import io
import json
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from PIL import Image

_FLOAT, _WORD, _ARRAY, _INDEX = 5126, 5125, 34962, 34963  # glTF's codes of types and of buffers
_NEAREST, _LINEAR, _MIPMAPS, _CLAMP = 9728, 9729, 9987, 33071


@dataclass(frozen=True, eq=False)
class Sheet:
    """Triangles in colours, with or without a texture.

    Attributes:
        vertices: (n, 3) m, in the frame of the object that Drake shows.
        faces: (m, 3), numbers of vertices.
        colours: (n, 3 or 4), linear RGB and alpha, factors of the texture where there is one; None for ones.
        uv: (n, 2), places in the texture: 0, 0 is its upper left corner, and 1, 1 its lower right one; None without.
        texture: (height, width, 3 or 4) uint8, sRGB with an alpha that is not premultiplied; None for none.
        blend: Flag: what is behind shines through by alpha, which does not count otherwise.
        sharp: Flag: pixels of the texture stay squares where it is enlarged.
    """

    vertices: np.ndarray
    faces: np.ndarray
    colours: np.ndarray | None = None
    uv: np.ndarray | None = None
    texture: np.ndarray | None = None
    blend: bool = False
    sharp: bool = False


def rectangle(width: float, height: float, texture: np.ndarray, *, sharp: bool = False) -> Sheet:
    """Return a texture (h, w, 3 or 4) uint8 in the plane of x and y [m], around the origin, with y upwards."""
    corners = np.array([[-1, 1], [1, 1], [1, -1], [-1, -1]]) * [0.5 * width, 0.5 * height]
    vertices, uv = np.column_stack((corners, np.zeros(4))), np.array([[0, 0], [1, 0], [1, 1], [0, 1]])
    faces = np.array([[0, 2, 1], [0, 3, 2]])
    return Sheet(vertices, faces, uv=uv, texture=texture, blend=texture.shape[-1] == 4, sharp=sharp)


def gltf_text(sheets: Sequence[Sheet]) -> str:
    """Text of a glTF file that holds sheets, one or more; everything is within it."""
    builder = _Builder()
    for sheet in sheets:
        builder.add(sheet)
    return builder.text()


class _Builder:
    def __init__(self) -> None:
        self._data = bytearray()
        self._primitives: list[dict[str, Any]] = []
        self._parts: dict[str, list[dict[str, Any]]] = {
            name: [] for name in ("materials", "textures", "samplers", "images", "accessors", "bufferViews")
        }

    def add(self, sheet: Sheet) -> None:
        # glTF's y is up where Drake's z is.
        upright = np.asarray(sheet.vertices, float)[:, [0, 2, 1]] * [1, 1, -1]
        attributes = {"POSITION": self._array(upright, _ARRAY)}
        if sheet.uv is not None:
            attributes["TEXCOORD_0"] = self._array(sheet.uv, _ARRAY)
        if sheet.colours is not None:
            attributes["COLOR_0"] = self._array(sheet.colours, _ARRAY)
        indices = self._array(np.asarray(sheet.faces, "<u4").reshape(-1), _INDEX)
        surface: dict[str, Any] = {"metallicFactor": 0.0}
        if sheet.texture is not None:
            surface["baseColorTexture"] = {"index": self._texture(sheet.texture, sheet.sharp)}
        material: dict[str, Any] = {
            "pbrMetallicRoughness": surface,
            "extensions": {"KHR_materials_unlit": {}},
            "alphaMode": "BLEND" if sheet.blend else "OPAQUE",
            "doubleSided": True,
        }
        number = self._put("materials", material)
        self._primitives.append({"attributes": attributes, "indices": indices, "material": number})

    def text(self) -> str:
        uri = f"data:application/octet-stream;base64,{base64.b64encode(self._data).decode()}"
        document = {
            "asset": {"version": "2.0", "generator": "pinwm_drake"},
            "extensionsUsed": ["KHR_materials_unlit"],
            "scene": 0,
            "scenes": [{"nodes": [0]}],
            "nodes": [{"mesh": 0}],
            "meshes": [{"primitives": self._primitives}],
            **{name: part for name, part in self._parts.items() if part},  # glTF allows no empty lists
            "buffers": [{"byteLength": len(self._data), "uri": uri}],
        }
        return json.dumps(document)

    def _put(self, part: str, entry: dict[str, Any]) -> int:
        self._parts[part].append(entry)
        return len(self._parts[part]) - 1

    def _array(self, values: np.ndarray, target: int) -> int:
        """Return the number of the accessor of new values: numbers (n,), or vectors (n, 2 to 4)."""
        whole = np.asarray(values).dtype.kind == "u"
        packed = np.ascontiguousarray(values, "<u4" if whole else "<f4")
        view = {"buffer": 0, "byteOffset": len(self._data), "byteLength": packed.nbytes, "target": target}
        self._data.extend(packed.tobytes())
        return self._put(
            "accessors",
            {
                "bufferView": self._put("bufferViews", view),
                "componentType": _WORD if whole else _FLOAT,
                "count": len(packed),
                "type": "SCALAR" if packed.ndim == 1 else f"VEC{packed.shape[1]}",
                "min": np.atleast_1d(packed.min(axis=0)).tolist(),
                "max": np.atleast_1d(packed.max(axis=0)).tolist(),
            },
        )

    def _texture(self, texture: np.ndarray, sharp: bool) -> int:
        larger = _NEAREST if sharp else _LINEAR
        sampler = {"magFilter": larger, "minFilter": _MIPMAPS, "wrapS": _CLAMP, "wrapT": _CLAMP}
        image = {"uri": f"data:image/png;base64,{base64.b64encode(png(texture)).decode()}"}
        return self._put("textures", {"source": self._put("images", image), "sampler": self._put("samplers", sampler)})


def png(picture: np.ndarray) -> bytes:
    """Return a picture (height, width, 3 or 4) uint8 as the bytes of a PNG file, made fast rather than small."""
    buffer = io.BytesIO()
    Image.fromarray(picture).save(buffer, format="PNG", compress_level=1)
    return buffer.getvalue()
