# SPDX-License-Identifier: MIT
"""Camera of a lab: pictures of one lamp's light, blurred by motion, with masks that are not quite the object's."""

from collections.abc import Iterator

import numpy as np
from pydrake.common.eigen_geometry import Quaternion
from pydrake.geometry import RenderEngineVtkParams
from pydrake.math import RigidTransform, RotationMatrix
from scipy.spatial.transform import Rotation, Slerp

from pinwm_drake.systems.runs.realism.lamp import draw_lamp, light
from pinwm_drake.systems.runs.realism.masks import blurred, draw_behind, ragged
from pinwm_drake.systems.runs.realism.mistakes import Realism
from pinwm_drake.systems.runs.recorder import SceneRecorder

_MOMENTS = 5  # of an exposure
_STILL = 2e-4  # m, that no corner moves by while an exposure needs no more than one moment


class LabCamera:
    """Camera whose pictures are as a lab has them.

    Args:
        recorder: The scene, which one lamp lights from then on.
        realism: How large mistakes are.
        corners: (n, 3) m, frame O, of the object.
        generator: Source of randomness.
        lamp: Renderer with a lamp; None draws one.
    """

    def __init__(
        self,
        recorder: SceneRecorder,
        realism: Realism,
        corners: np.ndarray,
        generator: np.random.Generator,
        lamp: RenderEngineVtkParams | None = None,
    ) -> None:
        self.recorder, self.realism = recorder, realism
        self._corners, self._generator = corners, generator
        light(recorder, draw_lamp(generator) if lamp is None else lamp)
        self._behind = draw_behind(generator)
        self.wider = float(generator.uniform(-1, 1) * (realism.mask - realism.flicker))

    def still(self, X_WO: RigidTransform, X_WC: list[RigidTransform]) -> Iterator[np.ndarray]:
        """Pictures (H, W, 4) uint8 of an object at rest, from poses of the camera."""
        for picture in self.recorder.pictures([X_WO] * len(X_WC), X_WC):
            yield self._masked(picture)

    def film(
        self,
        log_t: np.ndarray,
        X_WO: list[RigidTransform],
        p_WP: np.ndarray,
        t: np.ndarray,
        X_WC: RigidTransform,
    ) -> Iterator[np.ndarray]:
        """Pictures (H, W, 4) uint8 of a push.

        Args:
            log_t: (m,) s, times of the motion.
            X_WO: m poses of the object.
            p_WP: (m, 3) m, places of the pusher.
            t: (n,) s, times of the pictures, each the middle of an exposure.
            X_WC: Pose of the camera.
        """
        spread = self.realism.exposure * (np.arange(_MOMENTS) + 0.5 - 0.5 * _MOMENTS) / _MOMENTS
        for time in t:
            X, p = moments(log_t, X_WO, p_WP, np.clip(time + spread, log_t[0], log_t[-1]))
            ends = [one.rotation().matrix() @ self._corners.T + one.translation()[:, None] for one in (X[0], X[-1])]
            if np.abs(ends[1] - ends[0]).max() < _STILL and np.abs(p[-1] - p[0]).max() < _STILL:
                X, p = X[2:3], p[2:3]
            yield self._masked(blurred(self.recorder.pictures(X, [X_WC] * len(X), p), self._behind))

    def _masked(self, picture: np.ndarray) -> np.ndarray:
        wider = self.wider + self._generator.normal(0.0, self.realism.flicker)
        return ragged(picture, wider, self._behind, self._generator, most=self.realism.mask)


def moments(
    log_t: np.ndarray, X_WO: list[RigidTransform], p_WP: np.ndarray, t: np.ndarray
) -> tuple[list[RigidTransform], np.ndarray]:
    """Poses of the object and places (n, 3) m of the pusher at times t (n,) s within a motion's times."""
    # Those around the times alone: Slerp prepares all that it is given.
    first = int(np.clip(np.searchsorted(log_t, t.min(), side="right") - 1, 0, len(log_t) - 2))
    last = max(int(np.searchsorted(log_t, t.max(), side="left")) + 1, first + 2)
    log_t, X_WO, p_WP = log_t[first:last], X_WO[first:last], p_WP[first:last]
    turns = Rotation.from_matrix(np.array([X.rotation().matrix() for X in X_WO]))
    x, y, z, w = Slerp(log_t, turns)(t).as_quat().T
    p_WO = np.array([X.translation() for X in X_WO])
    places = np.column_stack([np.interp(t, log_t, p_WO[:, k]) for k in range(3)])
    q = np.column_stack([w, x, y, z])
    X = [RigidTransform(RotationMatrix(Quaternion(wxyz=q_k)), p_k) for q_k, p_k in zip(q, places, strict=True)]
    return X, np.column_stack([np.interp(t, log_t, p_WP[:, k]) for k in range(3)])
