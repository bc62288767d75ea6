"""COLMAP's sparse models, with their images."""

from pathlib import Path

from pinwm_drake.capture.importers.colmap_model import ModelImage, read_model
from pinwm_drake.capture.importers.similarity import Similarity
from pinwm_drake.capture.importers.target import PosedImage, Scenery, write_scenery, write_static
from pinwm_drake.capture.paths import is_file, is_folder, require_file
from pinwm_drake.errors import InputError
from pinwm_drake.files import appearing
from pinwm_drake.spatial.poses import identity

_MODEL_FOLDERS = ("", "sparse/0", "sparse", "0")
_MODEL_FILES = ("images.bin", "images.txt")


def import_colmap(
    source: Path,
    out: Path,
    scenery: Scenery,
    similarity: Similarity,
    *,
    images: Path | None = None,
    masks: Path | None = None,
) -> int:
    """Makes a capture of a COLMAP model: static views, without episodes.

    Args:
        source: The model, or a folder with the model in `sparse/0` and its images in `images`.
        out: The capture; not there yet, or empty.
        scenery: The parts of the scene that the model does not have.
        similarity: Similarity from the model's world, whose origin, axes and unit are arbitrary, to the capture's.
        images: Folder of the images; None for `images` in `source` or beside the model.
        masks: Folder of the masks, as `NAME.png` for an image `NAME`, or with its name up to the suffix; None
            where the images have alpha or a white background.

    Returns:
        How many views there are.

    Raises:
        InputError: The model, an image or a mesh is refused; see `read_model` and `read_image`.
    """
    model = _model_folder(source)
    folder = images or _image_folder(source, model)
    posed = [_posed(image, folder, masks) for image in read_model(model)]
    with appearing(out) as capture:
        write_scenery(capture, scenery, scenery.X_WO or identity())
        write_static(capture, posed, similarity)
    return len(posed)


def _model_folder(source: Path) -> Path:
    for name in _MODEL_FOLDERS:
        if any(is_file(source / name / file) for file in _MODEL_FILES):
            return source / name
    found = "a folder without images.bin or images.txt" if is_folder(source) else "no such folder"
    raise InputError(source, value=found, allowed="a COLMAP model, or a folder with one in sparse/0")


def _image_folder(source: Path, model: Path) -> Path:
    for folder in (source / "images", model / "images", model.parent / "images", model.parent.parent / "images"):
        if is_folder(folder):
            return folder
    raise InputError(source / "images", value="no such folder", allowed="the images, or --images DIR")


def _posed(image: ModelImage, images: Path, masks: Path | None) -> PosedImage:
    path = require_file(images / image.name, "the image that the model names")
    mask = None
    if masks is not None:
        names = [masks / f"{image.name}.png", (masks / image.name).with_suffix(".png")]
        mask = next((name for name in names if is_file(name)), None)
        if mask is None:
            raise InputError(names[0], value="no such file", allowed=f"the mask of {image.name}")
    return PosedImage(path, mask, image.camera, image.X_SC)
