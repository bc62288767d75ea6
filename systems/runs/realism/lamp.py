# SPDX-License-Identifier: MIT
"""One lamp instead of light from all sides: shadows, highlights, and colours that change as an object turns."""

from pathlib import Path
from typing import Any

import numpy as np
import trimesh
from pydrake.geometry import LightParameter, MakeRenderEngineVtk, RenderEngineVtkParams, Rgba

from pinwm_drake.systems.runs.recorder import SceneRecorder

_RENDERER = "vtk"  # the name that `cameras.object_camera` gives
_ROUGHNESS = 0.4
_SHADOW_MAP = 2048  # px, of the lamp's cone
_HEIGHTS = (0.6, 0.85)  # sine of the lamp's height above the horizon
_LAMP, _ROOM = 1.8, 0.35  # intensities
_AWAY, _CONE = 1.2, 25.0  # m, from the world's origin; degrees, to each side
_ROOM_LIGHTS, _ROOM_AWAY = 4, 2.0  # m


def glossy_model(visual_path: Path, folder: Path) -> Path:
    """Return a coloured mesh as a glTF file of glossy materials.

    Args:
        visual_path: OBJ file whose faces have materials with a Kd, m.
        folder: Folder of the file.

    Returns:
        The file; its y is the object's z, as Drake expects of a glTF.
    """
    options: dict[str, Any] = {"force": "scene", "group_material": True, "split_object": False, "process": False}
    by_material: Any = trimesh.load(visual_path, **options)
    scene = trimesh.Scene()
    for one in reversed(by_material.geometry.values()):  # in the order of the file
        name, colour = one.visual.material.name, one.visual.material.kwargs["kd"]
        corners = np.asarray(one.triangles).reshape(-1, 3)[:, [0, 2, 1]] * [1, 1, -1]
        across = np.cross(corners[1::3] - corners[::3], corners[2::3] - corners[::3])
        normals = np.repeat(across / np.linalg.norm(across, axis=1, keepdims=True), 3, axis=0)
        numbers = np.arange(len(corners)).reshape(-1, 3)
        material = trimesh.visual.material.PBRMaterial(
            name=name, baseColorFactor=[*colour, 1.0], metallicFactor=0.0, roughnessFactor=_ROUGHNESS
        )
        visual = trimesh.visual.TextureVisuals(material=material)
        part = trimesh.Trimesh(corners, numbers, vertex_normals=normals, visual=visual, process=False)
        scene.add_geometry(part, geom_name=name, node_name=name)
    path = folder / f"{visual_path.stem}.gltf"
    for name, content in scene.export(file_type="gltf", include_normals=True).items():
        (folder / (path.name if name.endswith(".gltf") else name)).write_bytes(content)
    return path


def light(recorder: SceneRecorder, params: RenderEngineVtkParams) -> None:
    """Lights the scene of a recorder as a renderer's parameters say, `draw_lamp`'s for one."""
    scene_graph = recorder.station.engine.scene_graph
    scene_graph.RemoveRenderer(_RENDERER)
    scene_graph.AddRenderer(_RENDERER, MakeRenderEngineVtk(params))


def draw_lamp(generator: np.random.Generator) -> RenderEngineVtkParams:
    """Return the renderer with one lamp that casts shadows from a random direction, and some light of the room."""
    angle, height = generator.uniform(-np.pi, np.pi), generator.uniform(*_HEIGHTS)
    flat = np.sqrt(1 - height**2)
    place = _AWAY * np.array([flat * np.cos(angle), flat * np.sin(angle), height])
    white = Rgba(1, 1, 1)
    lamp = LightParameter(
        type="spot", color=white, frame="world", intensity=_LAMP, position=place, direction=-place, cone_angle=_CONE
    )
    lights = [lamp]
    for k in range(_ROOM_LIGHTS):
        turn = 2 * np.pi * (k + 0.5) / _ROOM_LIGHTS
        place = _ROOM_AWAY * np.array([np.cos(turn), np.sin(turn), 0.5])
        # Points cast no shadows.
        lights.append(LightParameter(type="point", color=white, frame="world", intensity=_ROOM, position=place))
    return RenderEngineVtkParams(
        default_clear_color=np.ones(3), lights=lights, cast_shadows=True, shadow_map_size=_SHADOW_MAP
    )
