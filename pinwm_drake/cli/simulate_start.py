"""Where the object is when a pusher's log begins."""

from pathlib import Path

import numpy as np
from pydrake.common.eigen_geometry import Quaternion
from pydrake.math import RigidTransform, RotationMatrix

from pinwm_drake.capture.episode_tables import read_object_poses
from pinwm_drake.capture.objects import CAPTURE_FILE
from pinwm_drake.capture.scene import EPISODES, read_capture
from pinwm_drake.geometry.meshes import load_mesh
from pinwm_drake.systems.setup import Setup
from pinwm_drake.systems.start import on_floor


def start_of_log(folder: Path, setup: Setup) -> RigidTransform | None:
    """The pose of the object with which an episode starts, on the floor of the setup.

    Args:
        folder: That of the log: an episode of a capture, or one that `pinwm simulate` wrote.
        setup: Its object may be another one.

    Returns:
        X_WO as the capture says it, or else as the table of poses beside the log does; None where there is neither.

    Raises:
        InputError: The capture or the table cannot be used.
    """
    whole = folder.absolute()
    if whole.parent.name == EPISODES and (whole.parent.parent / CAPTURE_FILE).is_file():
        start = read_capture(whole.parent.parent).object.X_WO
        q_WO, p_WO = start.q.numpy(), start.p.numpy()
    else:
        poses = read_object_poses(folder)
        if poses is None:
            return None
        q_WO, p_WO = poses.q_WO[0], poses.p_WO[0]
    R_WO = RotationMatrix(Quaternion(wxyz=q_WO / np.linalg.norm(q_WO)))
    return on_floor(load_mesh(setup.twin.mesh_path).vertices, R_WO, p_WO[0], p_WO[1], setup.twin.floor_height)
