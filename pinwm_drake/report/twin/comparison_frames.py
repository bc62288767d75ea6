# SPDX-License-Identifier: MIT
"""Pictures of an episode: its images beside renderings of the surfels at given poses, and their difference.

Captures leave the pusher out; the pictures show it where its log has it.
"""

from collections.abc import Callable
from dataclasses import dataclass
from functools import partial

import numpy as np
import torch
import trimesh
from PIL import Image

from pinwm_drake.capture.episodes import Episode, ObjectPoses, read_episode_image
from pinwm_drake.capture.pusher import pusher_surface
from pinwm_drake.geometry.meshes import load_mesh
from pinwm_drake.rendering.camera import Camera, zoomed
from pinwm_drake.rendering.render import render
from pinwm_drake.rendering.silhouette import silhouette
from pinwm_drake.rendering.surfels import Surfels
from pinwm_drake.report.camera import ViewCamera
from pinwm_drake.report.scene import PLAIN, Actor, Surface, to_srgb
from pinwm_drake.report.style import evenly
from pinwm_drake.spatial.poses import Pose, compose, inverse, transform
from pinwm_drake.spatial.rotations import quaternion_to_matrix
from pinwm_drake.twin.frame import frame_of, moved_pose, pivot_of
from pinwm_drake.twin.origin import of_push, time_offset
from pinwm_drake.twin.twin import Twin

PANELS = ("camera", "twin", "difference")
_COVERED = 0.5  # alpha from which on a pixel of a rendering shows the object
_NEAR = 1e-3  # m; a mesh closer to the camera, or behind it, is not drawn
_MARGIN = 0.06  # of the window in which the object moves
_LOOKED_AT = 6  # frames in which the object is looked for
_SECTIONS = 16  # sides of a pusher that is drawn
PUSHER_COLOUR = (0.10, 0.25, 0.55)  # linear RGB


@dataclass(frozen=True, eq=False)
class Cast:
    """Bodies to draw, and corrections of camera and clock."""

    mesh: trimesh.Trimesh  # m, frame O
    surfels: Surfels  # frame O
    pusher: trimesh.Trimesh  # m, frame P
    camera_offset: tuple[float, float]  # px, to add to cx and cy
    time_offset: float = 0.0  # s, to add to a frame's time for that of the pusher
    actors: tuple[Actor, Actor] | None = (
        None  # the object, which hides the pusher, and the pusher; None to draw neither
    )
    outline: float = 1.0  # factor by which the object is larger in the images than its surfels are
    view: tuple[float, float, float] = (0.0, 0.0, 0.0)  # m, world: how far aside the camera shows the object
    placed: Callable[[Pose], Pose] = lambda X_WP: X_WP  # from the pusher's log to the world of the object

    @staticmethod
    def of(twin: Twin, push: int | None) -> "Cast":
        """Cast of a twin for an identified push, by its number, or for another one; InputError for a mesh of no use."""
        outline = of_push(twin, "outline", push or 0, 1.0)
        x, y, z = (of_push(twin, f"view_{axis}", push or 0, 0.0) for axis in "xyz")
        mesh, pusher = load_mesh(twin.mesh_path), pusher_surface(twin.pusher, sections=_SECTIONS)
        return Cast(
            mesh=mesh,
            actors=(Actor.from_mesh(mesh, PLAIN, smooth=False), Actor.from_mesh(pusher, PUSHER_COLOUR, smooth=True)),
            surfels=twin.surfels,
            pusher=pusher_surface(twin.pusher),
            camera_offset=twin.camera_offset,
            time_offset=time_offset(twin, push),
            outline=outline if outline > 0 else 1.0,
            view=(0.0, 0.0, 0.0) if push is None else (x, y, z),
            placed=partial(moved_pose, frame=frame_of(twin), pivot=pivot_of(twin)),
        )


@dataclass(frozen=True, eq=False)
class Picture:
    """Picture of one frame, as it is and as it is rendered."""

    t: float  # s
    image: np.ndarray  # (height, width, 3) float32 in [0, 1], sRGB, white where the object is not
    mask: np.ndarray  # (height, width) bool, true where the image shows the object
    rendered: np.ndarray  # rendering of the surfels, in the form of `image`
    covered: np.ndarray  # pixels of the rendered surfels, in the form of `mask`
    hidden: np.ndarray  # (height, width) bool: the pusher is there, and the image shows no object
    pusher: np.ndarray  # (height, width, 3) in [0, 1], sRGB: the pusher where its log has it
    pusher_nearest: np.ndarray  # (height, width) bool: the pusher is there, and no object at its pose hides it

    def shown_image(self) -> np.ndarray:
        """Image (height, width, 3) in [0, 1] with the pusher, which captures leave out, where the log has it."""
        return np.where(self.hidden[..., None], self.pusher, self.image)

    def shown_rendering(self) -> np.ndarray:
        """Rendering (height, width, 3) in [0, 1] with the pusher."""
        return np.where(self.pusher_nearest[..., None], self.pusher, self.rendered)

    def shown_difference(self) -> np.ndarray:
        """Difference (height, width, 3) of the two in [0, 1], on white; light blue where the pusher hides."""
        shown = 1.0 - np.abs(self.rendered - self.image)
        shown[self.hidden] = (0.80, 0.88, 0.97)
        return shown

    def overlap(self) -> float:
        """Intersection over union of the two outlines, without what the pusher hides; 1 where both are empty."""
        covered = self.covered & ~self.hidden
        union = int((self.mask | covered).sum())
        return float((self.mask & covered).sum() / union) if union else 1.0


def draw_frame(episode: Episode, k: int, poses: ObjectPoses, cast: Cast) -> Picture:
    """Frame k of an episode and its rendering at row k of the poses, in the size of the camera.

    Raises:
        InputError: The image cannot be used.
    """
    image, mask = read_episode_image(episode.folder, episode.file_names[k], episode.camera)
    camera = episode.camera.shifted(cast.camera_offset)
    X_CW = inverse(episode.X_WC)
    X_WO = Pose(torch.from_numpy(poses.q_WO[k].copy()), torch.from_numpy(poses.p_WO[k] + cast.view))
    with torch.no_grad():
        rendering = render(cast.surfels, _zoomed(camera, mask, cast.outline), compose(X_CW, X_WO), full=False)
    X_WP = cast.placed(episode.pusher_pose(float(episode.t[k]) + cast.time_offset))
    outline = silhouette(cast.pusher, camera, compose(X_CW, X_WP))
    covered = rendering.alpha[0].numpy() > _COVERED
    hidden = np.zeros_like(mask) if outline is None else outline & ~mask
    pusher, nearest = _draw_pusher(cast, ViewCamera.of(camera, episode.X_WC), X_WO, X_WP, covered)
    return Picture(
        t=float(episode.t[k]),
        image=image,
        mask=mask,
        rendered=rendering.color[0].clamp(0, 1).numpy(),
        covered=covered,
        hidden=hidden,
        pusher=pusher,
        pusher_nearest=nearest,
    )


def _draw_pusher(
    cast: Cast, view: ViewCamera, X_WO: Pose, X_WP: Pose, covered: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """Picture of the pusher (height, width, 3) in [0, 1], sRGB, and where it is seen (height, width) bool.

    Nothing of it is seen where a body reaches behind the camera.
    """
    picture, seen = np.ones((view.height, view.width, 3)), np.zeros((view.height, view.width), bool)
    if cast.actors is None:
        return picture, seen
    placed = [
        (actor, quaternion_to_matrix(X.q).numpy(), X.p.numpy())
        for actor, X in zip(cast.actors, (X_WO, X_WP), strict=True)
    ]
    corners = [actor.at(R, p)[0].reshape(-1, 3) for actor, R, p in placed]
    if min(float(view.project(points)[1].min()) for points in corners) < _NEAR:
        return picture, seen
    surface = Surface.of(view, placed[1:])
    drawn = surface.owner >= 0
    picture[drawn] = to_srgb(surface.lit(drawn, view.rays()[drawn])) / 255
    seen = drawn
    if (drawn & covered).any():
        seen = drawn & ((surface.inverse_depth > Surface.of(view, placed[:1]).inverse_depth) | ~covered)
    return picture, seen


def _zoomed(camera: Camera, mask: np.ndarray, outline: float) -> Camera:
    """Return the camera to which the object appears `outline` times as large about its middle in the image."""
    rows, columns = np.nonzero(mask)
    middle = [columns.mean() + 0.5, rows.mean() + 0.5] if len(rows) else [0.5 * camera.width, 0.5 * camera.height]
    scale, about = (torch.tensor(value, dtype=torch.float64) for value in (outline, middle))
    return Camera(camera.width, camera.height, zoomed(camera.intrinsics, scale, about))


def window_of(episode: Episode, poses: ObjectPoses, cast: Cast) -> tuple[slice, slice]:
    """Return the rows and columns in which the object moves, as posed and as seen in a few images, and the pusher.

    There is a margin around them. They are all of them where the poses lead behind the camera. Raises InputError where
    an image cannot be used.
    """
    X_CW, times = inverse(episode.X_WC), [float(t) + cast.time_offset for t in episode.t]
    X_WO = [Pose(torch.from_numpy(q), torch.from_numpy(p)) for q, p in zip(poses.q_WO, poses.p_WO, strict=True)]
    parts = [
        (cast.mesh.vertices, X_WO),
        (cast.pusher.bounding_box.vertices, [cast.placed(episode.pusher_pose(t)) for t in times]),
    ]
    size = np.array([episode.camera.width, episode.camera.height])
    everything = slice(0, int(size[1])), slice(0, int(size[0]))
    fx, fy, cx, cy = episode.camera.intrinsics.tolist()
    points = []
    for vertices, placed in parts:
        corners = [transform(compose(X_CW, X), torch.from_numpy(np.array(vertices))).numpy() for X in placed]
        p_C = np.concatenate(corners)
        if p_C[:, 2].min() < _NEAR:
            return everything
        points.append(p_C[:, :2] / p_C[:, 2:] * [fx, fy] + [cx, cy])
    for k in evenly(len(episode.t), _LOOKED_AT):
        _, mask = read_episode_image(episode.folder, episode.file_names[k], episode.camera)
        points.append(np.argwhere(mask)[:, ::-1] + 0.5)
    pixels = np.concatenate(points)
    low, high = np.maximum(pixels.min(axis=0), 0), np.minimum(pixels.max(axis=0), size)
    margin = _MARGIN * (high - low).max() + 2
    low, high = np.floor(np.maximum(low - margin, 0)), np.ceil(np.minimum(high + margin, size))
    if (high - low).min() < 1:
        return everything
    (left, top), (right, bottom) = low.astype(int).tolist(), high.astype(int).tolist()
    return slice(top, bottom), slice(left, right)


@dataclass(frozen=True, eq=False)
class Shot:
    """Panels of one frame, and the measures of their agreement."""

    t: float  # s
    overlap: float  # intersection over union of the outlines in the image and in the rendering
    difference: float  # mean absolute difference of the colours, 0 to 1, where one of them shows the object
    panels: tuple[np.ndarray, np.ndarray, np.ndarray]  # of `PANELS`: (height, width, 3) uint8, sRGB, of one size

    def joined(self) -> np.ndarray:
        """Picture of the three panels side by side."""
        return np.concatenate(self.panels, axis=1)


def draw_shots(
    episode: Episode,
    poses: ObjectPoses,
    cast: Cast,
    *,
    size: int,
    most: int,
    report: Callable[[float], None] = lambda share: None,
) -> list[Shot]:
    """Draws the frames of an episode as camera, twin and difference, all of one size with even width and height.

    Args:
        episode: The episode.
        poses: Poses of the object at its frames.
        cast: Object, pusher and corrections.
        size: The longer side of a panel [px] at most.
        most: Number of frames at most; of more, this many at equal distances.
        report: Called with the share that is done.

    Raises:
        InputError: An image cannot be used.
    """
    episode.require_film()
    window = window_of(episode, poses, cast)
    chosen, shots = evenly(len(episode.t), most), []
    for k in chosen:
        picture = draw_frame(episode, k, poses, cast)
        either = picture.mask | (picture.covered & ~picture.hidden)
        difference = float(np.abs(picture.image - picture.rendered)[either].mean()) if either.any() else 0.0
        camera, twin, shown = (
            _shrunk(part[window], size)
            for part in (picture.shown_image(), picture.shown_rendering(), picture.shown_difference())
        )
        shots.append(Shot(picture.t, picture.overlap(), difference, (camera, twin, shown)))
        report(len(shots) / len(chosen))
    return shots


def _shrunk(picture: np.ndarray, size: int) -> np.ndarray:
    """Picture in uint8 from one in [0, 1], made smaller where it is too large."""
    pixels = Image.fromarray((255 * np.clip(picture, 0, 1) + 0.5).astype(np.uint8))
    share = min(1.0, size / max(pixels.size))
    # Even numbers, as video needs them.
    width, height = (max(2 * round(0.5 * share * length), 2) for length in pixels.size)
    return np.asarray(pixels.resize((width, height), Image.Resampling.LANCZOS))
