"""Import of the data of PIN-WM's authors: pushes in Bullet, with masked images and static views.

    dynamic_train0.json     ee_init_position, ee_goal_position: (x, y) or (x, y, z) of the pusher [m]
                            image_datas: of each image c2w (3 x 4, OpenGL axes), intrinsic (3 x 3) and
                              file_path, `.../r_CAMERA_FRAME.png`; `.../m_CAMERA_FRAME.png` is its masked twin
                            pose_datas: optional; x, y, z, qx, qy, qz, qw of the object at each frame
    transforms_train.json   static views, as NeRF writes them

Frames are 1/24 s apart. At each the pusher's velocity becomes 5/s times the way that is left to the goal, in the
plane, and stays so until the next.

Source: Li et al., "PIN-WM" (2025); the layout is that of their released loader and training script.
"""

import re
from pathlib import Path

import numpy as np
import torch

from pinwm_drake.capture.images import read_image, require_size
from pinwm_drake.capture.importers.nerfstudio import read_posed_images
from pinwm_drake.capture.importers.pinwm_push import RATE, ReleasedPush, read_push
from pinwm_drake.capture.importers.similarity import scaled_world
from pinwm_drake.capture.importers.target import Scenery, copy_file, write_scenery
from pinwm_drake.capture.importers.views import write_static
from pinwm_drake.capture.paths import is_file, is_folder
from pinwm_drake.capture.scene import EPISODES
from pinwm_drake.capture.write import write_episode_tables
from pinwm_drake.errors import InputError
from pinwm_drake.files import appearing
from pinwm_drake.spatial.poses import Pose

_STATIC = ("transforms_train.json", "transforms.json")
_FILES = re.compile(r"dynamic_(train|test)(\d{1,5})\.json", re.ASCII)


def import_pinwm(
    source: Path,
    out: Path,
    scenery: Scenery,
    *,
    pusher_height: float | None = None,
    camera: int | None = None,
    static: Path | None = None,
) -> list[str]:
    """Makes a capture of a folder in the layout of PIN-WM's authors.

    Args:
        source: The folder.
        out: The capture; not there yet, or empty.
        scenery: Meshes and what else the data do not say; without X_WO, that of the first pose of the object.
        pusher_height: m, z of the pusher; None where the data have it.
        camera: Number of one of several cameras; None for the one with the lowest number.
        static: The static views' file; None for `transforms_train.json` or `transforms.json` in `source`.

    Returns:
        The files of the pushes, which become episodes 0000, 0001, ...

    Raises:
        InputError: A file is missing or unreadable, a value is missing or out of range, a camera moves, or there
            is no pose of the object.
    """
    files = _push_files(source)
    views = read_posed_images(static or _static_file(source))
    pushes = [read_push(path, pusher_height=pusher_height, camera=camera) for path in files]
    with appearing(out) as folder:
        write_scenery(folder, scenery, scenery.X_WO or _first_pose(files[0], pushes[0]))
        write_static(folder, views, scaled_world())
        for k, push in enumerate(pushes):
            _write_push(folder / EPISODES / f"{k:04}", push)
    return [path.name for path in files]


def _push_files(source: Path) -> list[Path]:
    """Files of pushes: those to train with by number, then those to test with."""
    if not is_folder(source):
        raise InputError(source, value="no such folder", allowed="a folder with dynamic_train0.json")
    found = [(match[1] == "test", int(match[2]), path) for path in source.iterdir() if (match := _name(path))]
    if not found:
        raise InputError(source, value="no dynamic_train*.json", allowed="a folder with dynamic_train0.json")
    return [path for *_, path in sorted(found)]


def _name(path: Path) -> re.Match[str] | None:
    return _FILES.fullmatch(path.name)


def _static_file(source: Path) -> Path:
    for name in _STATIC:
        if is_file(source / name):
            return source / name
    raise InputError(source, value="no " + " or ".join(_STATIC), allowed="static views, or --static FILE")


def _first_pose(path: Path, push: ReleasedPush) -> Pose:
    if push.poses is None:
        raise InputError(path, value="no pose_datas", allowed="poses of the object, or --pose for where it starts")
    return Pose(torch.tensor(push.poses.q_WO[0]), torch.tensor(push.poses.p_WO[0]))


def _write_push(folder: Path, push: ReleasedPush) -> None:
    names = [f"rgb/{frame:05}{path.suffix.lower()}" for frame, path in zip(push.frames, push.images, strict=True)]
    for path, name in zip(push.images, names, strict=True):
        require_size(path, read_image(path, may_be_empty=True)[1], push.camera, "as its camera has")
        copy_file(path, folder / name)
    t = np.array(push.frames) / RATE
    write_episode_tables(folder, push.camera, push.X_WC, names, t, push.trajectory, push.poses)
