# SPDX-License-Identifier: MIT
"""Scene of the renderer's benchmark: the T-block, as surfels for us and as its mesh for Drake's VTK renderer."""

from collections.abc import Callable
from pathlib import Path

import numpy as np
import torch
import trimesh
from pydrake.common.eigen_geometry import Quaternion
from pydrake.geometry import (
    ClippingRange,
    ColorRenderCamera,
    GeometryInstance,
    MakeRenderEngineVtk,
    Mesh,
    PerceptionProperties,
    RenderCameraCore,
    RenderEngineVtkParams,
    RenderLabel,
    Rgba,
    SceneGraph,
)
from pydrake.math import RigidTransform
from pydrake.systems.sensors import CameraInfo

from pinwm_drake.models import model_path
from pinwm_drake.rendering.camera import Camera
from pinwm_drake.rendering.surfels import Surfels
from pinwm_drake.spatial.poses import Pose, inverse
from pinwm_drake.spatial.rotations import matrix_to_quaternion
from pinwm_drake.systems.scenario.viewpoints import look_at

FOCAL = 965.685424949238 / 800  # of the capture in shared/data, per pixel of width
DISTANCE = 0.53  # m, as there: the block covers 6 % of the image


def camera(size: int) -> Camera:
    """Camera of a square image with the capture's field of view."""
    focal = FOCAL * size
    return Camera(size, size, torch.tensor([focal, focal, 0.5 * size, 0.5 * size], dtype=torch.float64))


def poses(number: int) -> Pose:
    """Poses X_CO from cameras on a circle around the block, looking down at it at 37 degrees: q (V, 4), p (V, 3)."""
    angles = np.linspace(0.0, 2.0 * np.pi, number, endpoint=False) + 0.3
    places = DISTANCE * np.column_stack([0.8 * np.cos(angles), 0.8 * np.sin(angles), np.full(number, 0.6)])
    views = [look_at(p_OC, np.zeros(3)).inverse() for p_OC in places]
    q = np.array([X.rotation().ToQuaternion().wxyz() for X in views])
    return Pose(torch.tensor(q), torch.tensor(np.array([X.translation() for X in views])))


def block() -> trimesh.Trimesh:
    """Return the mesh of the T-block."""
    return trimesh.load(model_path("t_block/t_block.obj"), force="mesh")


def surfels(number: int, views: int | None = None) -> Surfels:
    """Surfels of degree 3, evenly on the block's surface: flat, opaque, just large enough to close it.

    With `views`, each view has harmonics of its own.
    """
    mesh = block()
    generator = torch.Generator().manual_seed(0)
    points, faces = trimesh.sample.sample_surface(mesh, number, seed=0)
    R = np.stack([trimesh.geometry.align_vectors([0, 0, 1], normal)[:3, :3] for normal in mesh.face_normals])
    spacing = float(np.sqrt(mesh.area / number))
    lead = () if views is None else (views,)
    shade = torch.as_tensor(0.3 + 0.2 * mesh.face_normals[faces, 2], dtype=torch.float32)
    base = torch.stack([shade, -torch.ones(number), -torch.ones(number)], -1)[:, None].expand(*lead, number, 1, 3)
    rest = 0.02 * torch.randn(*lead, number, 15, 3, generator=generator)
    return Surfels(
        torch.as_tensor(points, dtype=torch.float32),
        matrix_to_quaternion(torch.as_tensor(R))[faces].float(),
        torch.full((number, 2), float(np.log(0.6 * spacing))),
        torch.full((number,), 3.0),
        torch.cat([base, rest], -2).contiguous(),
    )


class Vtk:
    """Drake's RenderEngineVtk on the block's mesh."""

    def __init__(self, folder: Path) -> None:
        """Write the mesh, with the normals that the engine wants, into a folder, and load it."""
        path = folder / "block.obj"
        corners = block()
        corners.unmerge_vertices()
        path.write_text(trimesh.exchange.obj.export_obj(corners, include_normals=True))
        graph = SceneGraph()
        graph.AddRenderer("vtk", MakeRenderEngineVtk(RenderEngineVtkParams()))
        source = graph.RegisterSource("block")
        instance = GeometryInstance(RigidTransform(), Mesh(str(path)), "block")
        properties = PerceptionProperties()
        properties.AddProperty("phong", "diffuse", Rgba(0.8, 0.1, 0.1, 1.0))
        properties.AddProperty("label", "id", RenderLabel(1))
        instance.set_perception_properties(properties)
        graph.RegisterAnchoredGeometry(source, instance)
        self._graph, self._world = graph, graph.world_frame_id()
        self._context = graph.CreateDefaultContext()

    def renderer(self, size: int, X_CO: Pose) -> Callable[[], object]:
        """Return a call that renders one color image, (size, size, 4) uint8."""
        focal = FOCAL * size
        info = CameraInfo(size, size, focal, focal, 0.5 * size, 0.5 * size)
        core = RenderCameraCore("vtk", info, ClippingRange(0.01, 10.0), RigidTransform())
        view = ColorRenderCamera(core, False)
        q, p = inverse(X_CO)
        X_OC = RigidTransform(Quaternion(q.numpy() / np.linalg.norm(q.numpy())), p.numpy())
        query = self._graph.get_query_output_port().Eval(self._context)
        return lambda: query.RenderColorImage(view, self._world, X_OC)
