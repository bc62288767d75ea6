# SPDX-License-Identifier: MIT
"""Pictures of rigid bodies on a floor: grid, soft shadow, paths and shaded meshes, seen by a fixed camera."""

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import cv2
import numpy as np
import trimesh
from scipy.spatial import cKDTree

from pinwm_drake.reading.meshes import read_scene
from pinwm_drake.report.camera import ViewCamera

PLAIN = (0.75, 0.16, 0.10)  # linear RGB, of a mesh without colours
_GAMMA = 2.2
# Unit vector towards the light, world; the light is far away.
_LIGHT_W = np.array([-0.38, -0.30, 0.875]) / np.linalg.norm([-0.38, -0.30, 0.875])
_FLOOR = np.array([0.80, 0.82, 0.85])
_SKY = np.array([0.93, 0.95, 0.97])
_MINOR, _MAJOR = 0.02, 0.10  # spacing of the floor's grid lines [m]
_SUPERSAMPLING = 2
_APART = 0.005  # m, by which opposite sides of a wall are apart for `Paint`


class Paint:
    """Colours of a surface by place and direction: those of the nearest of some samples.

    Args:
        points: (n, 3) m, body frame.
        normals: (n, 3), outward, unit.
        colours: (n, 3), sRGB in [0, 1].
    """

    def __init__(self, points: np.ndarray, normals: np.ndarray, colours: np.ndarray) -> None:
        self._tree = cKDTree(np.concatenate((points, _APART * normals), axis=1))
        self._colours = np.clip(colours, 0, 1) ** _GAMMA

    def at(self, points: np.ndarray, normals: np.ndarray) -> np.ndarray:
        """Colours (k, 3), linear RGB, at points (k, 3) [m] with outward unit normals (k, 3), body frame."""
        _, nearest = self._tree.query(np.concatenate((points, _APART * normals), axis=1))
        return np.asarray(self._colours[nearest])


@dataclass(frozen=True)
class Actor:
    """Mesh to be shown at changing poses."""

    corners_B: np.ndarray  # (n, 3, 3) [m], of each triangle, counter-clockwise from outside, body frame
    normals_B: np.ndarray  # (n, 3, 3), outward unit normals at the corners, body frame
    colour: np.ndarray  # (3,), linear RGB in [0, 1]
    paint: Paint | None = None  # in place of the colour

    @classmethod
    def from_mesh(cls, mesh: trimesh.Trimesh, colour: tuple[float, float, float], *, smooth: bool) -> "Actor":
        """Actor from a triangle mesh [m, body frame] and a linear RGB colour in [0, 1].

        Its normals are interpolated where it is smooth, as on a sphere, and constant on each face otherwise.
        """
        flat = np.repeat(mesh.face_normals[:, None], 3, axis=1)
        return cls(mesh.triangles, mesh.vertex_normals[mesh.faces] if smooth else flat, np.array(colour))

    def at(self, R_WB: np.ndarray, p_WB: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Corners (n, 3, 3) [m] and normals (n, 3, 3) in the world, for a pose (3, 3), (3,) [m]."""
        return self.corners_B @ R_WB.T + p_WB, self.normals_B @ R_WB.T


def coloured_actors(path: Path) -> list[Actor]:
    """Return the surfaces of a mesh file [m, object frame], one for each of its materials."""
    actors = []
    for part in read_scene(path).geometry.values():
        material = getattr(part.visual, "material", None)
        colour = PLAIN
        if material is not None and material.name and hasattr(material, "diffuse"):
            red, green, blue = ((float(value) / 255.0) ** _GAMMA for value in material.diffuse[:3])
            colour = (red, green, blue)
        actors.append(Actor.from_mesh(part, colour, smooth=False))
    return actors


@dataclass
class Surface:
    """Buffers of the surface that each pixel shows: the nearest one so far."""

    inverse_depth: np.ndarray  # (height, width) [1/m], 0 where there is nothing
    normal: np.ndarray  # (height, width, 3), outward, world, not quite of unit length where it is interpolated
    colour: np.ndarray  # (height, width, 3), linear RGB in [0, 1]
    owner: np.ndarray  # (height, width) int, number of the actor; -1 where there is nothing

    @classmethod
    def empty(cls, camera: ViewCamera) -> "Surface":
        """Buffers in which nothing has been drawn."""
        shape = (camera.height, camera.width)
        three = (*shape, 3)
        numbers = np.full(shape, -1, np.int16)
        return cls(np.zeros(shape, np.float32), np.zeros(three, np.float32), np.zeros(three, np.float32), numbers)

    @classmethod
    def of(cls, camera: ViewCamera, actors: Sequence[tuple[Actor, np.ndarray, np.ndarray]]) -> "Surface":
        """Buffers of actors, each with its pose R_WB (3, 3), p_WB (3,) [m]."""
        surface = cls.empty(camera)
        for number, (actor, R_WB, p_WB) in enumerate(actors):
            draw_triangles(surface, camera, *actor.at(R_WB, p_WB), actor.colour, number)
            if actor.paint is None:
                continue
            mine = surface.owner == number
            p_W = camera.points(1 / surface.inverse_depth[mine], mine)
            normals = surface.normal[mine] / np.linalg.norm(surface.normal[mine], axis=-1, keepdims=True)
            surface.colour[mine] = actor.paint.at((p_W - p_WB) @ R_WB, normals @ R_WB)
        return surface

    def lit(self, shown: np.ndarray, rays: np.ndarray) -> np.ndarray:
        """Light of the pixels of a mask: sky from above, one lamp, and its highlight; (n, 3) linear RGB.

        Args:
            shown: (height, width) bool; a surface is there.
            rays: (n, 3), unit, world: directions through these pixels.
        """
        normal, colour = self.normal[shown], self.colour[shown]
        normal = normal / np.linalg.norm(normal, axis=-1, keepdims=True)
        halfway = _LIGHT_W.astype(np.float32) - rays
        halfway = halfway / np.linalg.norm(halfway, axis=-1, keepdims=True)
        ambient = 0.36 + 0.14 * normal[:, 2:]
        lamp = np.clip(normal @ _LIGHT_W.astype(np.float32), 0, 1)[:, None]
        highlight = np.einsum("ij,ij->i", normal, halfway)[:, None]
        return np.asarray(colour * (ambient + 0.72 * lamp) + 0.18 * np.clip(highlight, 0, 1) ** 40 * (lamp > 0))


def draw_triangles(
    surface: Surface,
    camera: ViewCamera,
    corners_W: np.ndarray,
    normals_W: np.ndarray,
    colour: np.ndarray,
    owner: int = 0,
) -> None:
    """Draws triangles where they are nearer than the surface in the buffers.

    Args:
        surface: The buffer, changed in place; of the camera's size.
        camera: The view. All triangles lie in front of it.
        corners_W: (n, 3, 3) [m], corners of each triangle, counter-clockwise seen from outside, world.
        normals_W: (n, 3, 3), outward normal at each corner, world.
        colour: (3,), linear RGB in [0, 1].
        owner: Number of the actor.
    """
    pixels, depths = camera.project(corners_W.reshape(-1, 3))
    pixels, inverse = pixels.reshape(-1, 3, 2), (1 / depths).reshape(-1, 3)
    a, b, c = pixels[:, 0], pixels[:, 1], pixels[:, 2]
    # With y down a triangle that faces the camera runs clockwise: its doubled area is negative.
    areas = (b[:, 0] - a[:, 0]) * (c[:, 1] - a[:, 1]) - (b[:, 1] - a[:, 1]) * (c[:, 0] - a[:, 0])
    size = np.array([camera.width, camera.height])
    lows = np.clip(np.floor(pixels.min(axis=1)).astype(int), 0, size)
    highs = np.clip(np.ceil(pixels.max(axis=1)).astype(int), 0, size)
    for k in np.flatnonzero((areas < 0) & (lows < highs).all(axis=1)):
        (x0, y0), (x1, y1) = lows[k], highs[k]
        x, y = np.arange(x0, x1) + 0.5, (np.arange(y0, y1) + 0.5)[:, None]
        weights = []
        for i, j in ((1, 2), (2, 0)):
            (px, py), (qx, qy) = pixels[k, i], pixels[k, j]
            weights.append((((qx - px) * (y - py) - (qy - py) * (x - px)) / areas[k]).astype(np.float32))
        weights.append(1 - weights[0] - weights[1])
        depth = sum(weight * value for weight, value in zip(weights, inverse[k], strict=True))
        window = np.s_[y0:y1, x0:x1]
        shown = (weights[0] >= 0) & (weights[1] >= 0) & (weights[2] >= 0)
        shown &= depth > surface.inverse_depth[window]
        surface.inverse_depth[window][shown] = depth[shown]
        mix = np.stack([weight[shown] for weight in weights], axis=-1)
        surface.normal[window][shown] = mix @ normals_W[k].astype(np.float32)
        surface.colour[window][shown] = colour
        surface.owner[window][shown] = owner


def to_srgb(image: np.ndarray) -> np.ndarray:
    """Picture (..., 3) uint8, sRGB, of linear RGB; values beyond 0 and 1 are cut off."""
    return (255 * np.clip(image, 0, 1) ** (1 / _GAMMA) + 0.5).astype(np.uint8)


class Stage:
    """Stage: a floor at one height, and the camera that looks at it."""

    def __init__(self, camera: ViewCamera, floor_height: float = 0.0) -> None:
        """Draws the empty floor once; its height is z in the world [m]."""
        self.camera = camera
        self.floor_height = floor_height
        self._large = camera.scaled(_SUPERSAMPLING)
        self._rays = self._large.rays().astype(np.float32)
        self._empty = _floor_picture(camera.p_WC, self._rays, floor_height)

    def picture(
        self,
        actors: Sequence[tuple[Actor, np.ndarray, np.ndarray]],
        paths: list[tuple[np.ndarray, tuple[float, float, float]]],
    ) -> np.ndarray:
        """Picture of actors and paths on the floor.

        Args:
            actors: Actors, each with its pose R_WB (3, 3), p_WB (3,) [m] in the world.
            paths: Lines on the floor, (n, 2) [m] in the world's x and y, each with its linear RGB colour.

        Returns:
            (height, width, 3) uint8, sRGB.
        """
        image = self._empty * self._shadow([actor.at(R_WB, p_WB)[0] for actor, R_WB, p_WB in actors])
        for points, colour in paths:
            if len(points) > 1:
                on_floor = np.column_stack((points, np.full(len(points), self.floor_height)))
                pixels = np.round(16 * self._large.project(on_floor)[0]).astype(np.int32)
                cv2.polylines(image, [pixels], False, colour, 2 * _SUPERSAMPLING, cv2.LINE_AA, shift=4)
        surface = Surface.of(self._large, actors)
        covered = surface.owner >= 0
        image[covered] = surface.lit(covered, self._rays[covered])
        size = (self.camera.width, self.camera.height)
        image = cv2.resize(np.clip(image, 0, 1), size, interpolation=cv2.INTER_AREA)
        return to_srgb(image)

    def _shadow(self, corners_W: list[np.ndarray]) -> np.ndarray:
        """Light that reaches the floor at each pixel: (height, width, 1), 1 in full light."""
        mask = np.zeros((self.camera.height, self.camera.width), np.float32)
        for corners in corners_W:
            heights = corners[..., 2:] - self.floor_height
            on_floor = corners - heights * _LIGHT_W / _LIGHT_W[2]
            pixels, _ = self.camera.project(on_floor.reshape(-1, 3))
            # Four binary digits of sub-pixel precision.
            for triangle in np.round(16 * pixels.reshape(-1, 3, 2)).astype(np.int32):
                cv2.fillConvexPoly(mask, triangle, 1.0, cv2.LINE_AA, shift=4)
        light = 1 - 0.5 * cv2.GaussianBlur(mask, (0, 0), self.camera.height / 110)
        return cv2.resize(light, (self._large.width, self._large.height))[..., None]


def _floor_picture(p_WC: np.ndarray, rays: np.ndarray, height: float) -> np.ndarray:
    """Return the floor with its grid, fading into the sky: (rows, columns, 3) linear RGB, float32."""
    below = rays[..., 2] < -1e-3
    distance = np.where(below, (height - p_WC[2]) / np.where(below, rays[..., 2], -1), 1e3)
    at = p_WC[:2] + distance[..., None] * rays[..., :2]
    shade = np.ones(rays.shape[:2])
    for spacing, strength in ((_MINOR, 0.05), (_MAJOR, 0.16)):
        for axis in (0, 1):
            value = at[..., axis] / spacing
            # Width of a pixel in units of the spacing, so that lines stay thin and fade far away.
            pixel = np.hypot(*np.gradient(value))
            line = np.clip(1.2 * _SUPERSAMPLING - np.abs(value - np.round(value)) / pixel, 0, 1)
            shade -= strength * line * np.clip(0.35 / pixel / _SUPERSAMPLING, 0, 1)
    haze = np.clip(1 - np.exp(-np.maximum(distance - 1.0, 0) / 1.2), 0, 1)[..., None]
    floor = (_FLOOR**2.2) * shade[..., None]
    return ((1 - haze) * floor + haze * _SKY**2.2).astype(np.float32)
