"""Cameras that are not quite where they are believed to be."""

import math
from collections.abc import Mapping

import numpy as np
from pydrake.common.eigen_geometry import AngleAxis
from pydrake.math import RigidTransform, RotationMatrix
from scipy.spatial.transform import Rotation

from pinwm_drake.errors import ParameterError


class Miscalibration:
    """Errors of the poses of the cameras of W worlds, drawn for each episode.

    A camera that is believed to be at X_WC is at X_WC X_CE. What it shows of an object at X_WO is what the camera that
    it is believed to be would show of one at X_WC X_CE⁻¹ X_WC⁻¹ X_WO, its pose as it is seen.

    Attributes:
        possible: Flag: cameras may be off.
    """

    def __init__(self, most: tuple[float, float], X_WC: RigidTransform, num_worlds: int) -> None:
        """Begins with cameras that are where they are believed to be.

        Args:
            most: m and rad, the largest move and turn. Their sizes are drawn evenly, and their directions too.
            X_WC: Pose of the camera, as it is believed to be, OpenCV axes.
            num_worlds: Number of worlds, W.

        Raises:
            ParameterError: A number is not finite, less than 0, or a turn more than π.
        """
        place, turn = (float(value) for value in most)
        if not (0.0 <= place < math.inf and 0.0 <= turn <= math.pi):
            raise ParameterError(f"camera_error: got {place} m, {turn} rad; allowed: 0 or more, finite, a turn up to π")
        self._most, self._X_WC = (place, turn), X_WC
        self.possible = place > 0.0 or turn > 0.0
        self._q, self._p = np.tile([1.0, 0.0, 0.0, 0.0], (num_worlds, 1)), np.zeros((num_worlds, 3))

    def begin(self, world: int, generator: np.random.Generator) -> RigidTransform:
        """Pose of the camera of a world, whose generator draws it, in its next episode."""
        along, about = (v / np.linalg.norm(v) for v in generator.normal(size=(2, 3)))
        place, turn = generator.uniform(0.0, self._most)
        X_WE = self._X_WC @ RigidTransform(RotationMatrix(AngleAxis(turn, about)), place * along)
        X_seen = self._X_WC @ X_WE.inverse()
        self._q[world], self._p[world] = X_seen.rotation().ToQuaternion().wxyz(), X_seen.translation()
        return X_WE

    def seen(self, object_state: np.ndarray) -> np.ndarray:
        """States (W, 13) of objects as their cameras show them, from those as they are: poses and velocities."""
        if not self.possible:
            return object_state
        turns = Rotation.from_quat(self._q, scalar_first=True)
        seen = object_state.copy()
        seen[:, :4] = (turns * Rotation.from_quat(object_state[:, :4], scalar_first=True)).as_quat(scalar_first=True)
        seen[:, 4:7] = turns.apply(object_state[:, 4:7]) + self._p
        seen[:, 7:10], seen[:, 10:] = turns.apply(object_state[:, 7:10]), turns.apply(object_state[:, 10:])
        return seen

    def get_state(self) -> dict[str, np.ndarray]:
        """What is seen of poses by name, for `set_state`; nothing where cameras are where they are believed to be."""
        return {"seen_q": self._q.copy(), "seen_p": self._p.copy()} if self.possible else {}

    def set_state(self, arrays: Mapping[str, np.ndarray]) -> None:
        """Restores the arrays of `get_state`."""
        if self.possible:
            self._q, self._p = arrays["seen_q"].copy(), arrays["seen_p"].copy()
