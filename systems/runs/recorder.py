# SPDX-License-Identifier: MIT
"""Runs a station and writes down what a robot would: the pusher's log, the object's poses, the pictures."""

from collections.abc import Callable, Iterator
from dataclasses import dataclass

import numpy as np
from pydrake.math import RigidTransform
from pydrake.systems.framework import DiagramBuilder

from pinwm_drake.capture.episodes import ObjectPoses, PusherTrajectory
from pinwm_drake.rendering.camera import Camera
from pinwm_drake.systems.cameras.object_camera import AddCaptureRig
from pinwm_drake.systems.engines.engine import PUSHER_PAIR, ContactForces
from pinwm_drake.systems.pusher.motion import StraightPush
from pinwm_drake.systems.runs.scripted import ScriptedStation
from pinwm_drake.systems.sampling import whole_multiple
from pinwm_drake.systems.scenario.schema import Scenario
from pinwm_drake.systems.scenario.setup import Setup
from pinwm_drake.systems.scenario.start import Place
from pinwm_drake.systems.station.station import make_station

_SETTLING_TIME = 0.25  # s
_AWAY = np.array([0.0, 0.0, 50.0])  # m, where the pusher is while it is not needed


@dataclass(frozen=True)
class Rates:
    """Rates of pictures, rows of the log, and steps of the plant.

    Attributes:
        frames: Pictures a second.
        records_per_frame: Rows of the pusher's log for each picture.
        steps_per_record: Time steps of the plant for each row.
    """

    frames: float
    records_per_frame: int
    steps_per_record: int

    @property
    def time_step(self) -> float:
        """Time step of the plant, s."""
        return 1 / (self.frames * self.records_per_frame * self.steps_per_record)


@dataclass(frozen=True, eq=False)
class Recording:
    """Recording of a push: pictures' times, the log, and poses.

    Attributes:
        t: (n,) [s], of the pictures.
        trajectory: The pusher's log, from the first picture to the last.
        object_poses: At the times of the pictures.
        X_WO: The same as Drake's poses.
        p_WP: (n, 3) m, the pusher at the times of the pictures.
        logged: Poses of the object at the times of the log.
    """

    t: np.ndarray
    trajectory: PusherTrajectory
    object_poses: ObjectPoses
    X_WO: list[RigidTransform]
    p_WP: np.ndarray
    logged: list[RigidTransform]


class SceneRecorder(ScriptedStation):
    """A station with a scripted pusher and a camera, ready to run.

    Args:
        scenario: Scene and engine; a row of the log takes a whole number of the pusher's periods.
        rates: Rates of pictures and of rows of the log.
        camera: Size and intrinsics (4,) of the pictures.
        supersampling: Rendered pixels for each of a picture, along each side.
        forces: Flag: the log has the force of the object on the pusher, in each row the mean since the row before.

    Attributes:
        rig: The camera.

    Raises:
        InputError: The object's mesh cannot be used.
        ParameterError: Rates and periods do not fit.
    """

    def __init__(
        self, scenario: Scenario | Setup, rates: Rates, camera: Camera, supersampling: int, *, forces: bool = False
    ) -> None:
        station = make_station(scenario)
        period, row = station.setup.period, rates.time_step * rates.steps_per_record
        whole_multiple("a row of the pusher's log", row, period, "pusher.period")
        graph, query = station.engine.scene_graph, station.GetOutputPort("query_object")

        def add_rig(builder: DiagramBuilder) -> None:
            self.rig = AddCaptureRig(builder, graph, camera, supersampling, query=query)

        super().__init__(station, extend=add_rig)
        self.rates, self.forces = rates, forces

    def settle(self, X_WO: RigidTransform) -> RigidTransform:
        """Let the object come to rest, without the pusher.

        Args:
            X_WO: Its pose at first, touching the floor.

        Returns:
            Its pose afterwards.
        """
        self.begin(Place(X_WO, _AWAY))
        for _ in self.advance_to([_SETTLING_TIME]):
            pass
        return self.station.object_pose(self.simulator.get_context())

    def push(
        self,
        X_WO: RigidTransform,
        push: StraightPush,
        number: int,
        watch: Callable[[float, RigidTransform], None] | None = None,
    ) -> Recording:
        """Pushes the object from rest.

        Args:
            X_WO: Its pose at first.
            push: What the pusher does.
            number: Of pictures that there will be.
            watch: Called with time [s] and pose of the object for each row of the log; what it raises ends the push.
        """
        self.begin(Place(X_WO, push.p_WP), push)
        per_frame = self.rates.records_per_frame
        period = 1 / (self.rates.frames * per_frame)
        times = np.arange((number - 1) * per_frame + 1) * period
        # Forces of every step of the plant: an impact is over within a few.
        parts = self.rates.steps_per_record if self.forces else 1
        poses, positions, forces = [], [], []
        for k in self.advance_to(np.arange((len(times) - 1) * parts + 1) * (period / parts)):
            if self.forces:
                forces.append(self._force())
            if k % parts == 0:
                poses.append(self.station.object_pose(self.simulator.get_context()))
                if watch is not None:
                    watch(float(times[k // parts]), poses[-1])
                positions.append(self.evaluate("pusher_state")[:3])
        p_WP, X_WO_frames, t_frames = np.array(positions), poses[::per_frame], times[::per_frame]
        v_WP = np.array([push.average_velocity(k, period) for k in range(len(times))])
        q_WP = np.tile([1.0, 0.0, 0.0, 0.0], (len(times), 1))
        p_WO = np.array([pose.translation() for pose in X_WO_frames])
        return Recording(
            t=t_frames,
            trajectory=PusherTrajectory(times, p_WP, q_WP, v_WP, _averages(forces, parts) if self.forces else None),
            object_poses=ObjectPoses(t_frames, p_WO, quaternions(X_WO_frames)),
            X_WO=X_WO_frames,
            p_WP=p_WP[::per_frame],
            logged=poses,
        )

    def _force(self) -> np.ndarray:
        """Force (3,) N of the object on the pusher in the step of the plant that ends now; world axes."""
        contact: ContactForces = self.evaluate("contact_forces")
        mine = [f_W for pair, f_W in zip(contact.pairs, contact.f_W, strict=True) if pair == PUSHER_PAIR]
        return -np.sum(mine, axis=0) if mine else np.zeros(3)

    def pictures(
        self, X_WO: list[RigidTransform], X_WC: list[RigidTransform], p_WP: np.ndarray | None = None
    ) -> Iterator[np.ndarray]:
        """Pictures of a scene that is put into one state after another.

        Args:
            X_WO: Poses of the object.
            X_WC: Poses of the camera, as many, OpenCV axes.
            p_WP: (n, 3) m, as many places of the pusher; None leaves it out.

        Yields:
            (H, W, 4) uint8 each; see `CaptureRig.take`.
        """
        context = self.diagram.CreateDefaultContext()
        for k, (X_WO_k, X_WC_k) in enumerate(zip(X_WO, X_WC, strict=True)):
            self.station.SetPlace(context, Place(X_WO_k, _AWAY if p_WP is None else p_WP[k]))
            yield self.rig.take(context, X_WC_k)


def _averages(forces: list[np.ndarray], parts: int) -> np.ndarray:
    """Means (m, 3) of the `parts` values up to each row of a log, but for the first row, which has one."""
    values = np.array(forces)
    return np.concatenate([values[:1], values[1:].reshape(-1, parts, 3).mean(axis=1)])


def quaternions(poses: list[RigidTransform]) -> np.ndarray:
    """Rotations (n, 4), wxyz, of poses, each nearest to the one before."""
    values: list[np.ndarray] = []
    for pose in poses:
        q = pose.rotation().ToQuaternion().wxyz()
        values.append(-q if values and q @ values[-1] < 0 else q)
    return np.array(values)
