"""Static views of a capture from the posed images of others."""

from dataclasses import dataclass
from pathlib import Path

from pinwm_drake.capture.images import read_image, require_size
from pinwm_drake.capture.importers.similarity import Similarity
from pinwm_drake.capture.importers.target import copy_file
from pinwm_drake.capture.write import write_posed_images
from pinwm_drake.errors import InputError
from pinwm_drake.rendering.camera import Camera
from pinwm_drake.spatial.poses import Pose


@dataclass(frozen=True, eq=False)
class PosedImage:
    """Posed image of others, with its camera.

    Attributes:
        path: The image.
        mask_path: The image of its mask, or None.
        camera: Size and intrinsics (4,).
        X_SC: Pose of the camera in the world S of the source, OpenCV axes; q (4,), p (3,) in the unit of S.
    """

    path: Path
    mask_path: Path | None
    camera: Camera
    X_SC: Pose


def write_static(folder: Path, images: list[PosedImage], similarity: Similarity) -> None:
    """Copies images and masks to `static/` and writes its `transforms.json`.

    Args:
        folder: The capture.
        images: All with masks, or none.
        similarity: Similarity from their world to that of the capture.

    Raises:
        InputError: An image is refused or of another size than its camera's, some have a mask and some not, or
            a file cannot be written.
    """
    frames: list[tuple[str, Camera, Pose]] = []
    masked = [image for image in images if image.mask_path is not None]
    for k, image in enumerate(images):
        if masked and image.mask_path is None:
            raise InputError(image.path, value="no mask", allowed="a mask for each image, or none at all")
        require_size(image.path, read_image(image.path, image.mask_path)[1], image.camera, "as its camera has")
        name = f"images/{k:05}{image.path.suffix.lower()}"
        copy_file(image.path, folder / "static" / name)
        if image.mask_path is not None:
            copy_file(image.mask_path, folder / f"static/masks/{k:05}{image.mask_path.suffix.lower()}")
        frames.append((name, image.camera, similarity.pose(image.X_SC)))
    write_posed_images(folder / "static/transforms.json", frames)
