# SPDX-License-Identifier: MIT
"""Surfels in meshcat: a small web server of this process, and the scene that it hands to every browser.

The server of the `meshcat` package, as it comes, listens for browsers on every interface of the machine whatever its
`host` says, and for drawing commands on a TCP port. Here it listens on one address only, and takes no commands: the
scene is placed in its tree.
"""

import asyncio
import contextlib
import signal
import socket
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import partial
from typing import Any

import numpy as np
import tornado.web
import trimesh
import umsgpack
from meshcat import commands, geometry
from meshcat.path import Path as ScenePath
from meshcat.servers.tree import find_node
from meshcat.servers.zmqserver import ZMQWebSocketBridge

from pinwm_drake.capture.pusher import pusher_surface
from pinwm_drake.errors import ParameterError
from pinwm_drake.geometry.meshes import load_mesh
from pinwm_drake.rendering.surfels import Surfels
from pinwm_drake.report.gltf import png
from pinwm_drake.report.orbit import AZIMUTH, ELEVATION, Orbit
from pinwm_drake.report.surfels.mesh import GAUSSIAN, SurfelMesh
from pinwm_drake.spatial.rotations import quaternion_to_matrix
from pinwm_drake.twin.twin import Twin

_APART = 0.5  # of the pusher's size, between it and the object

LOCALHOST, FIRST_PORT = "127.0.0.1", 7000
_PORTS = 100  # tried one after the other
# meshcat's camera sees 75 degrees of height: this share of the distance for 30 degrees shows the object as large.
_CLOSER = 0.35
# meshcat turns z up for three.js, whose y is up; below this node poses are in three.js's axes.
_CAMERA = "/Cameras/default/rotated/<object>"


@dataclass(frozen=True, eq=False)
class Solid:
    """Mesh beside the surfels; the page's controls hide and show it."""

    name: str  # of its node in the scene
    mesh: trimesh.Trimesh  # m, object frame O
    colour: int  # 0xrrggbb
    opacity: float  # 0 to 1
    shown: bool = True  # at first


def serve_surfels(
    surfels: Surfels,
    *,
    solids: Sequence[Solid] = (),
    host: str = LOCALHOST,
    port: int | None = None,
    ready: Callable[[str], None],
) -> None:
    """Show surfels until the process is interrupted (Ctrl-C) or told to end, which ends the call normally.

    Args:
        surfels: Surfels, one or more, with one set of colours.
        solids: Meshes to show beside them.
        host: Address or name of the interface to listen on; by default this machine itself only.
        port: Port to listen on; None for the first one that is free from 7000 on.
        ready: Called with the address of the page when the server listens.

    Raises:
        ParameterError: The address cannot be listened on, or the port is taken.
        RenderingError: There are no surfels.
    """
    scene = _scene(surfels, solids)
    port = _free_port(host, port)
    with contextlib.suppress(KeyboardInterrupt):
        asyncio.run(_serve(scene, host, port, ready))


async def _serve(scene: list[dict[str, Any]], host: str, port: int, ready: Callable[[str], None]) -> None:
    """Listen until the process is told to end, or the task is cancelled."""
    bridge = _Bridge(zmq_url="inproc://pinwm", host=host, port=port)
    try:
        for command in scene:
            node = find_node(bridge.tree, [part for part in command["path"].split("/") if part])
            data = umsgpack.packb(command)
            if command["type"] == "set_object":
                node.object = data
            else:
                node.properties.append(data)
        ready(f"http://{f'[{host}]' if ':' in host else host}:{port}/static/")
        stop, loop = asyncio.Event(), asyncio.get_running_loop()
        # Of our own: a process started in the background may have been told to ignore Ctrl-C.
        for number in (signal.SIGINT, signal.SIGTERM):
            with contextlib.suppress(NotImplementedError, RuntimeError, ValueError):  # Windows, or another thread
                loop.add_signal_handler(number, stop.set)
        await stop.wait()
    finally:
        bridge.zmq_stream.close()


class _Bridge(ZMQWebSocketBridge):  # type: ignore[misc]  # meshcat has no types
    def make_app(self) -> tornado.web.Application:
        """Web application that listens on the server's address; the base class gives it the port only."""
        app = super().make_app()
        app.listen = partial(app.listen, address=self.host)
        return app


def _free_port(host: str, port: int | None) -> int:
    ports = range(FIRST_PORT, FIRST_PORT + _PORTS) if port is None else [port]
    reason = ""
    for candidate in ports:
        try:
            family, kind, protocol, _, address = socket.getaddrinfo(host, candidate, type=socket.SOCK_STREAM)[0]
            with socket.socket(family, kind, protocol) as probe:
                probe.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
                probe.bind(address)
                return candidate
        except (OSError, OverflowError) as error:
            reason = str(getattr(error, "strerror", None) or error)
    where = f"{host}:{port}" if port is not None else f"{host}, ports {ports[0]} to {ports[-1]}"
    raise ParameterError(f"--host, --port: got {where} ({reason}); allowed: an address of this machine and a free port")


def _scene(surfels: Surfels, solids: Sequence[Solid]) -> list[dict[str, Any]]:
    """Commands to meshcat that show the surfels around the origin, seen from the orbit's first look."""
    orbit, mesh = Orbit.around(surfels), SurfelMesh.from_surfels(surfels)
    outward = -quaternion_to_matrix(orbit.pose(AZIMUTH, ELEVATION).q)[2]
    x, y, z = (_CLOSER * orbit.distance * outward).tolist()
    hidden = [commands.SetProperty("visible", False, ScenePath((name,))) for name in ("Grid", "Axes")]
    white = [commands.SetProperty(f"{end}_color", [1, 1, 1], ScenePath(("Background",))) for end in ("top", "bottom")]
    eye = commands.SetProperty("position", [x, z, -y], ScenePath(tuple(_CAMERA.strip("/").split("/"))))
    shift = orbit.target.astype(np.float32)
    cores = geometry.TriangularMeshGeometry(mesh.core_vertices - shift, mesh.core_faces, mesh.core_colours)
    # Unlit: the light of the pictures is in the colours.
    opaque, soft = geometry.MeshBasicMaterial(vertexColors=True), _rim_material()
    surface = [commands.SetObject(_Rims(mesh, shift), soft, ScenePath(("meshcat", "surfels", "rims")))]
    if len(mesh.core_faces):
        surface.append(commands.SetObject(cores, opaque, ScenePath(("meshcat", "surfels", "cores"))))
    others = [
        commands.SetObject(
            geometry.TriangularMeshGeometry(solid.mesh.vertices - orbit.target, solid.mesh.faces),
            geometry.MeshPhongMaterial(color=solid.colour, opacity=solid.opacity, transparent=solid.opacity < 1),
            ScenePath(("meshcat", solid.name)),
        )
        for solid in solids
    ]
    hidden += [
        commands.SetProperty("visible", False, ScenePath(("meshcat", one.name))) for one in solids if not one.shown
    ]
    return [command.lower() for command in (*surface, *others, *hidden, *white, eye)]


class _Rims(geometry.TriangularMeshGeometry):  # type: ignore[misc]
    """Mesh of meshcat, with places in a texture, and colours with opacities."""

    def __init__(self, mesh: SurfelMesh, shift: np.ndarray) -> None:
        super().__init__(mesh.rim_vertices - shift, mesh.rim_faces)
        self.mesh = mesh

    def lower(self, object_data: dict[str, Any]) -> dict[str, Any]:
        message: dict[str, Any] = super().lower(object_data)
        for name, values in (("uv", self.mesh.rim_uv), ("color", self.mesh.rim_colours)):
            message["data"]["attributes"][name] = geometry.pack_numpy_array(values.T)
        return message


def _rim_material() -> geometry.MeshBasicMaterial:
    """Material of rims, which are mixed with what is there and hide nothing."""
    texture = geometry.ImageTexture(geometry.PngImage(png(GAUSSIAN)))
    return geometry.MeshBasicMaterial(map=texture, vertexColors=True, transparent=True, depthWrite=False)


def twin_solids(twin: Twin) -> list[Solid]:
    """Return the mesh of a twin's object, hidden at first, and its pusher, which stands beside it on the same level."""
    mesh, pusher = load_mesh(twin.mesh_path), pusher_surface(twin.pusher)
    (low, high), size = mesh.bounds, pusher.extents
    place = np.array([high[0] + _APART * size[0], 0.5 * (low[1] + high[1]), low[2]])
    pusher.apply_translation(place - [pusher.bounds[0, 0], pusher.bounds[:, 1].mean(), pusher.bounds[0, 2]])
    return [Solid("mesh", mesh, 0x808080, 0.25, shown=False), Solid("pusher", pusher, 0x4A4A50, 1.0)]
