# SPDX-License-Identifier: MIT
"""Pictures of a push at one resolution, and the pixels on which they can be compared with a rendering."""

from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np
import torch
import trimesh
from scipy.ndimage import binary_dilation
from torch import Tensor

from pinwm_drake.capture.episodes import Episode, View, read_episode_image
from pinwm_drake.errors import InputError
from pinwm_drake.rendering.camera import Camera
from pinwm_drake.rendering.silhouette import silhouette
from pinwm_drake.spatial.poses import Pose, compose, inverse

# Free space around the object in a picture, on each side, as a share of its longer side.
_MARGIN = 0.2


@dataclass(frozen=True, eq=False)
class Pictures:
    """Pictures of n frames, each cut out and scaled."""

    camera: Camera  # Cameras of the frames: intrinsics (n, 4)
    color: Tensor  # (n, H, W, 3) float32, white where the object is not
    alpha: Tensor  # (n, H, W) float32, the share of a pixel that shows the object
    weight: Tensor  # (n, H, W) float32, 0 where the pusher may hide the object, else 1
    middle: Tensor  # (n, 2), float64: middle of the object in the image, px; about it outlines are scaled
    X_CW: Pose  # Poses of the world in the frames' cameras, OpenCV axes; q (n, 4), p (n, 3) [m]

    def some(self, chosen: Tensor) -> "Pictures":
        """Subset of the frames, by their indices (m,)."""
        return replace(
            self,
            camera=replace(self.camera, intrinsics=self.camera.intrinsics[chosen]),
            color=self.color[chosen],
            alpha=self.alpha[chosen],
            weight=self.weight[chosen],
            middle=self.middle[chosen],
            X_CW=Pose(self.X_CW.q[chosen], self.X_CW.p[chosen]),
        )


@dataclass(frozen=True, eq=False)
class Frame:
    """Part of an image that shows the object."""

    view: View  # Camera that took it
    t: float  # When it was taken, s
    x: int  # First column
    y: int  # First row
    pixels: np.ndarray  # (h, w, 4) uint8: red, green, blue over white, and 255 on the object; empty where there is none


@dataclass(frozen=True, eq=False)
class Footage:
    """Frames of a push, of all of its cameras, as far as they show the object."""

    episode: Episode
    numbers: Tensor  # Numbers (n,) of the frames, increasing, in the order of `episode.times`
    frames: list[Frame]
    offset: tuple[float, float]  # px, to be added to the principal points, as the static views revealed
    pusher: trimesh.Trimesh  # Surface of the pusher, frame P, m

    def some(self, numbers: Tensor) -> "Footage":
        """Footage of some of the frames, by their numbers (m,), increasing."""
        at = torch.searchsorted(self.numbers, numbers)
        return replace(self, numbers=numbers, frames=[self.frames[k] for k in at.tolist()])

    @property
    def longest(self) -> int:
        """Longest side of the object in any frame, px."""
        return max(max(frame.pixels.shape[:2]) for frame in self.frames)


def spaced(number: int, most: int) -> Tensor:
    """Return indices (m,) of at most so many of a number of things, evenly spaced from the first to the last."""
    return torch.linspace(0, number - 1, min(most, number)).round().long()


def first_frames(episode: Episode) -> Tensor:
    """Numbers of the first frame of each camera, in the order of `episode.times`."""
    counts = torch.tensor([len(view.t) for view in episode.views])
    return counts.cumsum(0) - counts


def read_footage(
    episode: Episode, pusher: trimesh.Trimesh, offset: tuple[float, float], numbers: Tensor | None = None
) -> Footage:
    """Read images of an episode, one at a time: of each, the part that shows the object is kept.

    Args:
        episode: Cameras, times, and the pusher's trajectory.
        pusher: Surface of the pusher, frame P, m.
        offset: px, added to the principal points.
        numbers: Numbers (n,) of the frames that are read, increasing; None for all.

    Raises:
        InputError: An image cannot be read, or none shows the object.
    """
    episode.require_film()
    images = [
        (view, name, t) for view in episode.views for name, t in zip(view.file_names, view.t.tolist(), strict=True)
    ]
    numbers = torch.arange(len(images)) if numbers is None else numbers
    wanted = [images[number] for number in numbers.tolist()]
    frames = [_cut(view, t, *read_episode_image(view.folder, name, view.camera)) for view, name, t in wanted]
    if not any(frame.pixels.size for frame in frames):
        raise InputError(episode.folder, value="no frame that shows the object", allowed="a video of the object")
    return Footage(episode, numbers, frames, offset, pusher)


def _cut(view: View, t: float, image: np.ndarray, mask: np.ndarray) -> Frame:
    """Frame from an image (H, W, 3) float32 and its mask (H, W) bool."""
    rows, columns = np.flatnonzero(mask.any(1)), np.flatnonzero(mask.any(0))
    if not len(rows):
        return Frame(view, t, 0, 0, np.zeros((0, 0, 4), np.uint8))
    part = (slice(rows[0], rows[-1] + 1), slice(columns[0], columns[-1] + 1))
    color = np.where(mask[part][..., None], image[part], 1.0)
    pixels = np.concatenate([np.rint(255.0 * color), 255.0 * mask[part][..., None]], -1).astype(np.uint8)
    return Frame(view, t, int(columns[0]), int(rows[0]), pixels)


def make_pictures(
    footage: Footage,
    size: float,
    *,
    together: bool,
    late: float = 0.0,
    placed: Callable[[Pose], Pose] = lambda X_WP: X_WP,
) -> Pictures:
    """Pictures of one resolution, in which the object is cut out.

    Args:
        footage: The frames.
        size: px, of the object's longer side in the result, at the most; images are never enlarged.
        together: Whether all frames of a camera share one box, around everything that the object swept; else each has
            its own.
        late: By how much the frames' clock is behind that of the pusher's log, s, for where the pusher hides pixels.
        placed: Function from a pose of the pusher's log to that in the world of the pictures, for the same.

    Returns:
        The pictures, all of one size.
    """
    factor = min(size / footage.longest, 1.0)
    boxes = [_scaled_boxes(footage, view, factor, together) for view in footage.episode.views]
    width, height = (int(max(extent[axis] for _, extent in boxes)) + 1 for axis in range(2))
    corners = [box for found, _ in boxes for box in found]
    parts = [
        _picture(footage, frame, box, (width, height), factor, placed(footage.episode.pusher_pose(frame.t + late)))
        for frame, box in zip(footage.frames, corners, strict=True)
    ]
    cut, behind, intrinsics = (torch.stack(part) for part in zip(*parts, strict=True))
    X_CW = [inverse(frame.view.X_WC) for frame in footage.frames]
    return Pictures(
        camera=Camera(width, height, intrinsics),
        color=cut[..., :3].contiguous(),
        alpha=cut[..., 3].contiguous(),
        weight=1.0 - behind,
        middle=torch.stack([_middle(picture[..., 3]) for picture in cut]),
        X_CW=Pose(torch.stack([X.q for X in X_CW]), torch.stack([X.p for X in X_CW])),
    )


def _scaled_boxes(footage: Footage, view: View, factor: float, together: bool) -> tuple[np.ndarray, np.ndarray]:
    """Middles (n, 2) of the boxes of a camera's frames in the scaled image, and their extent (2,), px."""
    frames = [frame for frame in footage.frames if frame.view is view]
    seen = [k for k, frame in enumerate(frames) if frame.pixels.size]
    if not seen:
        centre = 0.5 * factor * np.array([view.camera.width, view.camera.height])
        return np.tile(centre, (len(frames), 1)), np.full(2, factor * footage.longest)
    low = np.array([[frames[k].x, frames[k].y] for k in seen], float)
    high = low + np.array([frames[k].pixels.shape[1::-1] for k in seen])
    room = _MARGIN * footage.longest * factor
    if together:
        low, high = low.min(0, keepdims=True), high.max(0, keepdims=True)
        extent = factor * (high - low)[0] + 4.0 * room
        return np.tile(0.5 * factor * (low + high), (len(frames), 1)), extent
    # A frame without the object is looked at where it was last seen.
    last = np.maximum(np.searchsorted(seen, np.arange(len(frames)), side="right") - 1, 0)
    return 0.5 * factor * (low + high)[last], factor * (high - low).max(0) + 2.0 * room


def _picture(
    footage: Footage, frame: Frame, middle: np.ndarray, size: tuple[int, int], factor: float, X_WP: Pose
) -> tuple[Tensor, Tensor, Tensor]:
    """Picture (H, W, 4) of a frame, hidden pixels (H, W) float32, and intrinsics (4,)."""
    width, height = size
    x, y = round(middle[0] - 0.5 * width), round(middle[1] - 0.5 * height)
    lens = frame.view.camera.shifted(footage.offset).intrinsics * factor
    camera = Camera(width, height, lens - lens.new_tensor([0.0, 0.0, x, y]))
    cut = np.ones((height, width, 4), np.float32)
    cut[..., 3] = 0.0
    if frame.pixels.size:
        rows = _overlap(height, y, factor, frame.y, frame.pixels.shape[0])
        columns = _overlap(width, x, factor, frame.x, frame.pixels.shape[1])
        pixels = frame.pixels.astype(np.float32) / 255.0
        pixels[..., :3] -= 1.0  # what is outside of the part is white
        cut += np.einsum("ir,rck,jc->ijk", rows, pixels, columns, optimize=True)
    X_CP = compose(inverse(frame.view.X_WC), X_WP)
    behind = hidden(footage.pusher, camera, X_CP).astype(np.float32)
    return torch.from_numpy(cut), torch.from_numpy(behind), camera.intrinsics


def _overlap(number: int, first: int, factor: float, start: int, count: int) -> np.ndarray:
    """Share (number, count) of each large pixel that small pixels cover, along one axis.

    Large pixel i covers [first + i, first + i + 1) / factor, small pixel j [start + j, start + j + 1).
    """
    low = (first + np.arange(number)[:, None]) / factor
    small = start + np.arange(count)[None]
    covered = np.minimum(low + 1.0 / factor, small + 1.0) - np.maximum(low, small)
    return np.asarray(np.clip(covered, 0.0, None) * factor, np.float32)


def hidden(pusher: trimesh.Trimesh, camera: Camera, X_CP: Pose) -> np.ndarray:
    """Mask (H, W) of the pixels of which the pusher, at a pose in the camera, may hide a part.

    They are those whose centre it covers and all around them: a centre that is not covered may be near what is.
    """
    covered = silhouette(pusher, camera, X_CP)
    if covered is None:
        return np.zeros((camera.height, camera.width), bool)
    return np.asarray(binary_dilation(covered, np.ones((3, 3), bool)))


def _middle(alpha: Tensor) -> Tensor:
    """Centroid of the object in a picture, px; the picture's middle where there is none."""
    H, W = alpha.shape
    total = float(alpha.sum())
    if total < 1.0:
        return torch.tensor([0.5 * W, 0.5 * H], dtype=torch.float64)
    x = float((alpha.sum(0) * (torch.arange(W) + 0.5)).sum()) / total
    y = float((alpha.sum(1) * (torch.arange(H) + 0.5)).sum()) / total
    return torch.tensor([x, y], dtype=torch.float64)
