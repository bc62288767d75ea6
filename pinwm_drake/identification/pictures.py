"""Pictures of a push at one resolution, and the pixels on which they can be compared with a rendering."""

from dataclasses import dataclass, replace

import torch
import trimesh
from torch import Tensor

from pinwm_drake.capture.episodes import Episode
from pinwm_drake.errors import InputError
from pinwm_drake.rendering.camera import Camera
from pinwm_drake.rendering.silhouette import silhouette
from pinwm_drake.spatial.poses import Pose, compose, inverse

# A small pixel counts where the pusher covers none of it.
_HIDDEN = 1e-3


@dataclass(frozen=True, eq=False)
class Pictures:
    """Pictures of n frames, each cut out and scaled.

    Attributes:
        camera: Cameras of the frames: intrinsics (n, 4).
        color: (n, H, W, 3) float32, white where the object is not.
        alpha: (n, H, W) float32, the share of a pixel that shows the object.
        weight: (n, H, W) float32, 0 where the pusher may hide the object, else 1.
        middle: (n, 2), float64: middle of the object in the image, px; about it outlines are scaled.
        X_CW: Pose of the world in the camera, OpenCV axes; q (4,), p (3,) [m].
    """

    camera: Camera
    color: Tensor
    alpha: Tensor
    weight: Tensor
    middle: Tensor
    X_CW: Pose

    def some(self, chosen: Tensor) -> "Pictures":
        """Subset of the frames, by their indices (m,)."""
        return replace(
            self,
            camera=replace(self.camera, intrinsics=self.camera.intrinsics[chosen]),
            color=self.color[chosen],
            alpha=self.alpha[chosen],
            weight=self.weight[chosen],
            middle=self.middle[chosen],
        )


@dataclass(frozen=True, eq=False)
class Footage:
    """All frames of an episode as they were read.

    Attributes:
        episode: Episode that the frames are of.
        camera: Camera with the offset that the static views revealed.
        images: (n, H, W, 3) float32.
        masks: (n, H, W) bool.
        hidden: (n, H, W) float32, 1 where the pusher may hide the object.
    """

    episode: Episode
    camera: Camera
    images: Tensor
    masks: Tensor
    hidden: Tensor


def make_footage(
    episode: Episode, images: Tensor, masks: Tensor, pusher: trimesh.Trimesh, offset: tuple[float, float]
) -> Footage:
    """Prepares frames: corrects the camera and marks the pusher.

    Args:
        episode: Camera, times, and the pusher's trajectory.
        images: (n, H, W, 3) float32.
        masks: (n, H, W) bool.
        pusher: Surface of the pusher, frame P, m.
        offset: px, added to the principal point.

    Raises:
        InputError: No frame shows the object.
    """
    if not bool(masks.any()):
        raise InputError(episode.folder, value="no frame that shows the object", allowed="a video of the object")
    camera, X_CW = episode.camera.shifted(offset), inverse(episode.X_WC)
    hidden = torch.zeros(masks.shape)
    for k, t in enumerate(episode.t.tolist()):
        pixels = silhouette(pusher, camera, compose(X_CW, episode.pusher_pose(t)))
        if pixels is not None:
            hidden[k] = torch.from_numpy(pixels)
    return Footage(episode, camera, images, masks, hidden)


def make_pictures(footage: Footage, size: float, *, together: bool, margin: float = 0.2) -> Pictures:
    """Scales the frames down and cuts the object out.

    Args:
        footage: The frames.
        size: px, of the object's longer side in the result, at the most; images are never enlarged.
        together: Whether all frames share one box, around everything that the object swept; else each has its own.
        margin: Free space around the object on each side, as a share of its longer side.

    Returns:
        The pictures.
    """
    boxes = torch.tensor([_box(mask) for mask in footage.masks if bool(mask.any())], dtype=torch.float64)
    longest = float((boxes[:, 2:] - boxes[:, :2]).max())
    factor = min(size / longest, 1.0)
    camera = footage.camera.scaled(factor)
    stack = torch.cat([footage.images, footage.masks[..., None].float(), footage.hidden[..., None]], -1)
    if camera.width != footage.camera.width:
        planes = stack.permute(0, 3, 1, 2)
        stack = torch.nn.functional.interpolate(planes, (camera.height, camera.width), mode="area").permute(0, 2, 3, 1)
    scaled = boxes * factor
    room = margin * longest * factor
    if together:
        whole = torch.cat([scaled[:, :2].amin(0), scaled[:, 2:].amax(0)])
        scaled = whole[None].expand(len(footage.masks), 4)
        room *= 2.0
    extent = (scaled[:, 2:] - scaled[:, :2]).amax(0) + 2.0 * room
    width, height = min(int(extent[0]) + 1, camera.width), min(int(extent[1]) + 1, camera.height)
    cuts, intrinsics, middles = [], [], []
    last = -1
    for k, mask in enumerate(footage.masks):
        # A frame without the object is looked at where it was last seen.
        last += int(mask.any())
        box = scaled[k if together else max(last, 0)]
        centre = 0.5 * (box[:2] + box[2:])
        x = min(max(round(float(centre[0]) - 0.5 * width), 0), camera.width - width)
        y = min(max(round(float(centre[1]) - 0.5 * height), 0), camera.height - height)
        cut = stack[k, y : y + height, x : x + width]
        cuts.append(cut)
        intrinsics.append(camera.cropped(x, y, width, height).intrinsics)
        middles.append(_middle(cut[..., 3]))
    cut = torch.stack(cuts)
    return Pictures(
        camera=Camera(width, height, torch.stack(intrinsics)),
        color=cut[..., :3].contiguous(),
        alpha=cut[..., 3].contiguous(),
        weight=(cut[..., 4] < _HIDDEN).float(),
        middle=torch.stack(middles),
        X_CW=inverse(footage.episode.X_WC),
    )


def _box(mask: Tensor) -> list[int]:
    """First column and row of the object, and those after its last."""
    rows, columns = torch.nonzero(mask, as_tuple=True)
    return [int(columns.min()), int(rows.min()), int(columns.max()) + 1, int(rows.max()) + 1]


def _middle(alpha: Tensor) -> Tensor:
    """Centroid of the object in a picture, px; the picture's middle where there is none."""
    H, W = alpha.shape
    total = float(alpha.sum())
    if total < 1.0:
        return torch.tensor([0.5 * W, 0.5 * H], dtype=torch.float64)
    x = float((alpha.sum(0) * (torch.arange(W) + 0.5)).sum()) / total
    y = float((alpha.sum(1) * (torch.arange(H) + 0.5)).sum()) / total
    return torch.tensor([x, y], dtype=torch.float64)
