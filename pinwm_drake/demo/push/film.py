"""The frames of the push's video."""

import math
from collections.abc import Callable, Iterator
from typing import cast

import numpy as np
import trimesh

from pinwm_drake.capture.pusher import pusher_surface
from pinwm_drake.capture.scene import PusherGeometry, PusherKind, PusherShape
from pinwm_drake.demo.push.scene import PUSHER_LENGTH, PUSHER_RADIUS, PushRecord
from pinwm_drake.report.camera import ViewCamera
from pinwm_drake.report.captions import write_caption
from pinwm_drake.report.scene import Actor, Stage

SIZE = (960, 540)  # [px]
RECORDS_PER_FRAME = 2  # of about 60 a second
_BLOCK_COLOUR, _PUSHER_COLOUR = (0.75, 0.16, 0.10), (0.10, 0.25, 0.55)


def film(
    mesh: trimesh.Trimesh, pusher: str, record: PushRecord, report: Callable[[float], None]
) -> Iterator[np.ndarray]:
    """Draws the push in real time.

    Args:
        mesh: The block, metres, body frame.
        pusher: Shape of the pusher.
        record: What to show.
        report: Called with the share of the frames that are done.

    Yields:
        Frames (height, width, 3) uint8, sRGB.
    """
    actor = Actor.from_mesh(mesh, _BLOCK_COLOUR, smooth=False)
    surface = pusher_surface(PusherGeometry(None, PusherShape(cast(PusherKind, pusher), PUSHER_RADIUS, PUSHER_LENGTH)))
    pusher_actor = Actor.from_mesh(surface, _PUSHER_COLOUR, smooth=pusher != "cylinder")
    stage = Stage(_camera(record))
    p_WB, p_WP = record.p_WB, record.p_WP
    for k in range(0, len(record.times), RECORDS_PER_FRAME):
        frame = stage.picture(
            [(actor, record.R_WB[k], p_WB[k]), (pusher_actor, np.eye(3), p_WP[k])],
            [(p_WB[: k + 1, :2], _BLOCK_COLOUR), (p_WP[: k + 1, :2], _PUSHER_COLOUR)],
        )
        moved, turned = 1e3 * np.linalg.norm(p_WB[k, :2] - p_WB[0, :2]), math.degrees(record.yaw[k])
        write_caption(frame, f"{record.times[k]:4.2f} s   moved {moved:3.0f} mm   turned {turned:+4.0f}°")
        yield frame
        report(min(1.0, (k + RECORDS_PER_FRAME) / len(record.times)))


def _camera(record: PushRecord) -> ViewCamera:
    """A view from the side and above that holds the whole push, with room for the block around its path."""
    places = np.concatenate((record.p_WB[:, :2], record.p_WP[:, :2]))
    low, high = places.min(axis=0) - 0.06, places.max(axis=0) + 0.06
    target = np.array([*(low + high) / 2, 0.01])
    eye = target + 1.55 * np.linalg.norm(high - low) * np.array([0.72, -0.42, 0.55])
    return ViewCamera.look_at(eye, target, width=SIZE[0], height=SIZE[1], field_of_view=math.radians(30))
