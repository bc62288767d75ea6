# SPDX-License-Identifier: MIT
"""Import of nerfstudio's `transforms.json` (and NeRF's, which says an angle and leaves the suffix out)."""

from pathlib import Path
from typing import Any

from pinwm_drake.capture.images import read_size
from pinwm_drake.capture.importers.lenses import OBEYED, nerfstudio_lens
from pinwm_drake.capture.importers.similarity import Similarity, scaled_world
from pinwm_drake.capture.importers.target import (
    PosedImage,
    Report,
    Scenery,
    tell_unposed,
    unheard,
    write_scenery,
    write_static,
)
from pinwm_drake.capture.lens import Lens
from pinwm_drake.capture.paths import is_file, is_folder
from pinwm_drake.capture.static_views import TRANSFORMS, find_mask
from pinwm_drake.capture.transforms import MAX_SIZE, Frame, focal_length, read_frame, require_different, require_known
from pinwm_drake.documents import Entry, read_json
from pinwm_drake.files import appearing
from pinwm_drake.spatial.poses import identity

_FARTHEST = 1e9  # units of a world that may not be in metres
_FOCALS = ("fl_x", "camera_angle_x"), ("fl_y", "camera_angle_y")
_OF_FILE = ("frames", "applied_transform", "applied_scale")
_SUFFIXES = (".png", ".jpg", ".jpeg", ".PNG", ".JPG")


def import_nerfstudio(
    source: Path, out: Path, scenery: Scenery, similarity: Similarity | None = None, *, report: Report = unheard
) -> int:
    """Make a capture of a nerfstudio folder: static views, without episodes. Returns how many views there are.

    Args:
        source: The folder, or its `transforms.json`.
        out: The capture; not there yet, or empty.
        scenery: The parts of the scene that the file does not have.
        similarity: Similarity from its world to that of the capture; None where they are the same, in metres.
        report: Called with the share of the images that are written.

    Raises:
        InputError: The file, an image or a mesh is refused; see `read_transforms` and `read_image`.
    """
    images = read_posed_images(source / TRANSFORMS if is_folder(source) else source)
    tell_unposed(source, [image.path for image in images])
    with appearing(out) as folder:
        X_WO = scenery.X_WO or identity()
        write_scenery(folder, scenery, X_WO)
        write_static(folder, images, similarity or scaled_world(), scenery.mesh, X_WO, report)
    return len(images)


def read_posed_images(path: Path) -> list[PosedImage]:
    """Images of a `transforms.json` of nerfstudio or NeRF, in its order; raises InputError as `read_transforms`."""
    document = read_json(path)
    require_known(document, OBEYED)
    found = [_read(document, entry) for entry in document["frames"].items()]
    frames = [frame for frame, _ in found]
    require_different(frames)
    masks = [frame.mask_path or find_mask(path.parent, frame.image_path) for frame in frames]
    return [
        PosedImage(frame.image_path, mask, frame.camera, frame.X_WC, lens)
        for (frame, lens), mask in zip(found, masks, strict=True)
    ]


def _read(document: Entry, entry: Entry) -> tuple[Frame, Lens | None]:
    """Frame of a `transforms.json`, with the defaults of nerfstudio filled in, and its lens if it has distortion."""
    require_known(entry, OBEYED)
    name = _image_name(entry)
    known: dict[str, Any] = {key: value for key, value in document.value.items() if key not in _OF_FILE}
    known |= {**entry.value, "file_path": name}
    if "w" not in known or "h" not in known:
        known["w"], known["h"] = read_size(entry.path.parent / name)
    own = Entry(entry.path, entry.place, known)
    size = own["w"].integer(1, MAX_SIZE), own["h"].integer(1, MAX_SIZE)
    for axis, (focal, key) in enumerate(_FOCALS):
        said_here = key in entry.value and focal not in entry.value
        if key in known and (said_here or focal not in known):
            known[focal] = focal_length(own[key], size[axis])
        elif focal in entry.value and key not in entry.value:
            known.pop(key, None)  # of the file, whose place the frame's own takes
    for key, value in (("fl_y", known.get("fl_x")), ("cx", 0.5 * size[0]), ("cy", 0.5 * size[1])):
        if key not in known and value is not None:
            known[key] = value
    frame = read_frame(Entry(entry.path, "", {}), own, _FARTHEST, OBEYED)
    return frame, nerfstudio_lens(own, frame.camera)


def _image_name(entry: Entry) -> str:
    """Path of the image, with the suffix that NeRF leaves out."""
    name, folder = entry["file_path"].text(), entry.path.parent
    if is_file(folder / name):
        return name
    found = [name + suffix for suffix in _SUFFIXES if is_file(folder / (name + suffix))]
    if len(found) > 1:
        raise entry["file_path"].refusal(f"one image: {found[0]} or {found[1]}")
    return found[0] if found else name
