# SPDX-License-Identifier: MIT
"""A bundle at the pace of whoever calls it: a robot's own program, or another simulator."""

from dataclasses import dataclass
from pathlib import Path

import numpy as np

from pinwm_drake.control.pilot import Inputs, Memory, Pilot
from pinwm_drake.control.safety_filter import Mode
from pinwm_drake.errors import StateError
from pinwm_drake.learning.bundle import Bundle, read_bundle
from pinwm_drake.learning.safety import SafetyLimits
from pinwm_drake.station.named import require_station, station_hash

_EARLY = 1e-6  # s, by which an action may be before its time


@dataclass(frozen=True, eq=False)
class PusherCommand:
    """Command to a robot's pusher.

    Attributes:
        velocity: (3,) m/s, world: of the pusher's frame P until the next command; zero unless running.
        state: "disarmed", "armed", "running", "latched" by a fault, or "done".
        reason: Words on what latched or ended it; empty where there is nothing to say.
        estimate: The policy's estimate of its task's state at the last action; None where it tells none.
    """

    velocity: np.ndarray
    state: Mode
    reason: str
    estimate: np.ndarray | None

    @property
    def done(self) -> bool:
        """Flag: nothing comes any more until a reset."""
        return self.state in ("done", "latched")


class Runner:
    """Bundle that is given images and the pusher's places as they come, and asked for commands.

    It keeps the frames in order, one an action, finds where the pusher was when an image was taken, limits speed,
    acceleration and place, latches at the first fault, and says when the task is over. Times are on one clock of the
    caller's, in s.

    Args:
        bundle: A bundle, its folder, or the name of one that ships.
        limits: Limits of the pusher's motion; None for the bundle's.
        live: Flag: images come from a real camera, of which no two are the same; False for those without noise.
        station: The `station.yaml` of the lab, or its folder; None for a bundle that names no station.

    Raises:
        InputError: The bundle cannot be read; or it names another station than this one; or it names one, images are
            live, and no station is given.
    """

    def __init__(
        self,
        bundle: Bundle | str | Path,
        limits: SafetyLimits | None = None,
        *,
        live: bool = True,
        station: str | Path | None = None,
    ) -> None:
        self.bundle = bundle if isinstance(bundle, Bundle) else read_bundle(bundle)
        if live or station is not None:
            name = "bundle" if isinstance(bundle, Bundle) else bundle
            found = None if station is None else station_hash(Path(station))
            require_station(name, self.bundle.spec.station, found, station)
        self.limits = limits or self.bundle.limits
        self._pilot = Pilot(self.bundle, self.limits, live=live)
        self.reset()

    def reset(self) -> None:
        """Forgets images, fault and end, and disarms, as at the beginning of an episode."""
        self._memory, self._next = Memory(), -np.inf
        self._image: tuple[float, np.ndarray] | None = None
        self._pusher: tuple[float, np.ndarray] | None = None

    def pusher(self, time: float, p_WP: np.ndarray) -> None:
        """Take a place of the pusher.

        Args:
            time: s, when it was there.
            p_WP: (3,) m, world.
        """
        place = np.asarray(p_WP, float).reshape(-1)
        state = np.concatenate([place, np.zeros(3)]) if place.shape == (3,) else place
        self._pusher = (float(time), state)

    def image(self, time: float, rgb: np.ndarray) -> None:
        """Take an image.

        Args:
            time: s, when it was taken.
            rgb: (height, width, 3 or 4) uint8: the object where it is seen, white elsewhere, sRGB.
        """
        self._image = (float(time), np.array(rgb))

    def arm(self) -> None:
        """Let the policy move the pusher from the next action on.

        Raises:
            StateError: There is no image, or no place of the pusher, or a reset is needed first.
        """
        seen = (("no image", self._image), ("no position of the pusher", self._pusher))
        missing = [name for name, value in seen if value is None]
        if missing:
            raise StateError(f"arm: {' and '.join(missing)} has come yet; arm when both are there")
        self._memory = self._pilot.arm(self._memory, self._memory.status.time)

    def command(self, time: float) -> PusherCommand:
        """Command for now, to be asked for at least once in a horizon; the oftener, the sooner a fault is seen.

        Args:
            time: s, now; not before that of the last call.
        """
        if self._image is not None and self._pusher is not None:
            (image_time, image), (pusher_time, state) = self._image, self._pusher
            inputs = Inputs(float(time), image_time, lambda: image, pusher_time, state)
            if time >= self._next - _EARLY:
                horizon = self.bundle.spec.horizon
                self._next = max(self._next, time - horizon) + horizon if np.isfinite(self._next) else time + horizon
                self._memory = self._pilot.act(self._memory, inputs)
            else:
                self._memory = self._pilot.look(self._memory, inputs)
        memory = self._memory
        estimate = np.array(memory.state) if memory.state else None
        return PusherCommand(np.array(memory.safety.v_WP), memory.safety.mode, memory.safety.reason, estimate)
