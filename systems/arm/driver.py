# SPDX-License-Identifier: MIT
"""Simulated driver of a robot: an arm with its camera, behind the messages that a real one would have."""

import numpy as np
from drake import lcmt_drake_signal  # type: ignore[import-untyped]  # LCM's types
from pydrake.geometry import Meshcat
from pydrake.lcm import DrakeLcmInterface
from pydrake.math import RigidTransform
from pydrake.systems.framework import Context, Diagram, DiagramBuilder
from pydrake.systems.lcm import LcmInterfaceSystem
from pydrake.systems.primitives import Demultiplexer, Multiplexer

from pinwm_drake.errors import ParameterError
from pinwm_drake.learning.safety import SafetyLimits
from pinwm_drake.systems.arm.control import AddArmControl, ToolState
from pinwm_drake.systems.arm.gate import CommandGate
from pinwm_drake.systems.arm.messages import STATE_NAMES, AddPandaMessages, ImageSender
from pinwm_drake.systems.arm.model import ARMS, JOINTS, ArmModel, ArmName
from pinwm_drake.systems.arm.plant import MakeArmPlant
from pinwm_drake.systems.cameras.object_camera import AddObjectImage
from pinwm_drake.systems.engines.lcm.messages import Tally, make_publisher
from pinwm_drake.systems.engines.lcm.seal import seal_of
from pinwm_drake.systems.engines.lcm.signal import SignalSender
from pinwm_drake.systems.engines.plant.forces import PlantForces
from pinwm_drake.systems.sampling import whole_multiple
from pinwm_drake.systems.scenario.setup import Setup
from pinwm_drake.systems.scenario.start import Place, StartDistribution
from pinwm_drake.systems.sdf.twin import ContactName
from pinwm_drake.systems.view.scene import AddSceneView

# s, of the plant: where the tool keeps its height, and where it lifts. With steps of 2.5 ms the hit that begins a lift
# throws the object.
TIME_STEP, LIFT_STEP = 0.0025, 0.00125
_HALF_HEIGHT = 0.01  # m, of the box that the tool may be in
_SUPERSAMPLING = 3
_EYE, _TARGET = np.array([1.3, -1.3, 1.0]), np.array([0.0, 0.15, 0.35])  # m, world, of the page's own look


class ArmDriver(Diagram):  # type: ignore[misc]  # pydrake has no usable types
    """Driver of a simulated arm, which does over LCM what a robot's driver does.

                                                       ┌───────────┐
        link.command_channel  lcmt_drake_signal (6) ──►│ ArmDriver │─► link.state_channel  lcmt_drake_signal (10)
                                                       │           │─► link.image_channel  lcmt_image_array
                                                       └───────────┘
            output ports, for whoever watches:   object_state  (13): q_WO, p_WO [m], ω_WO, v_WO, world
                                                 pusher_state   (6): p_WP [m], v_WP [m/s] of the tool, world
                                                 tool_target    (6): the same, as commanded and limited
                                                 arm_state     (14): angles [rad] and velocities [rad/s] of the joints

    The tool, a pusher at the end of a rod that points down, follows the commanded velocity of one session, within the
    scenario's speed and the part of its box that the arm reaches; where z is no axis of the task, it keeps the height
    of `scenario.start`.
    Where they stop for longer than `link.timeout`, it slows down to rest and waits for a new session; so it does at a
    command that must not be: see `CommandGate`. The camera sees the arm as well: it hides what is behind it.

    Measured with the IIWA and actions of 0.1 s in random directions: the tool is 1.5 mm (rms; 2.4 mm at most) from
    where it is to be at that moment at 0.2 m/s, since it is late by some 7 ms; off the path by 1.1 mm at most; and
    within 0.2 mm of its height, in both contact models and with steps of 1 or 2.5 ms. Flips have steps of 1.25 ms.

    The rod of the Panda swings for speed: see `JointTracker`. Its tool has 7 m/s^2 and is 0.2 mm (rms) off at 0.2 m/s
    and 5.4 mm at 1.25 m/s (`benchmarks.arm_tracking`). Its joints' commands and states are sent as `lcmt_panda_command`
    and `lcmt_panda_status` as well: see `AddPandaMessages`.

    It can be simulated alone, or in a diagram beside a station. Object and tool are to be put into place with
    `SetPlace`.

    Args:
        setup: The scene; `setup.scenario.lcm` says which channels are used.
        lcm: `make_lcm` of that; the very object that the station has, where both are in one process over `memq://`.
        arm: Name of the arm, of `ARMS`.
        contact: The contact model; "point" takes half the time, 0.7 s of one core for 1 s.
        time_step: s, of the plant; None for `TIME_STEP`, or `LIFT_STEP` where z is an axis of the task.
        latency: s, of the camera, from exposure to sending; rounded to periods of the link.
        meshcat: Shows arm and object, if given.

    Attributes:
        limits: Limits of the tool's motion.
        model: The arm's kinematics.
        tally: Counts of commands that were not used.

    Raises:
        InputError: A mesh, or the key of the link, cannot be used.
        ParameterError: The scene is out of the arm's reach, or periods and time steps do not divide each other.
    """

    def __init__(
        self,
        setup: Setup,
        lcm: DrakeLcmInterface,
        *,
        arm: ArmName = "iiwa",
        contact: ContactName = "hydroelastic",
        time_step: float | None = None,
        latency: float = 0.0,
        meshcat: Meshcat | None = None,
    ) -> None:
        super().__init__()
        link = setup.scenario.lcm
        time_step = time_step or (LIFT_STEP if moves_up(setup) else TIME_STEP)
        whole_multiple("lcm.image_period", link.image_period, link.period, "lcm.period")
        whole_multiple("lcm.period", link.period, time_step, "the plant's time step")
        self.setup, self.limits, self._lcm = setup, arm_limits(setup, arm), lcm
        self.tally, seal = Tally(), seal_of(link, driver=True)
        height = setup.scenario.start.pusher_height
        self.model = ArmModel(setup.twin.floor_height, height, arm)
        self._height = None if moves_up(setup) else height
        builder = DiagramBuilder()
        builder.AddNamedSystem("lcm", LcmInterfaceSystem(lcm))
        self._parts, self._arm = MakeArmPlant(builder, setup, time_step, contact, arm)
        parts = self._parts
        plant = parts.plant
        tool = builder.AddNamedSystem("tool_state", ToolState(parts.pusher.index()))
        builder.Connect(plant.get_body_poses_output_port(), tool.GetInputPort("body_poses"))
        builder.Connect(plant.get_body_spatial_velocities_output_port(), tool.GetInputPort("body_velocities"))
        stream, measured, wanted = AddArmControl(builder, self.model, self.limits, link.period, self._height, time_step)
        builder.Connect(tool.get_output_port(), stream.GetInputPort("pusher_state"))
        builder.Connect(plant.get_state_output_port(self._arm), measured)
        if arm == "panda":
            wanted = AddPandaMessages(builder, lcm, link.period, plant, self._arm, wanted)
        builder.Connect(wanted, plant.get_desired_state_input_port(self._arm))
        # Plans of an arm whose rod may swing keep the joints' speeds, so that only what it touches exceeds them.
        fastest = self.model.plant.GetVelocityUpperLimits() if self.model.kind.swings else None
        gating = CommandGate(lcm, link, self.limits.max_speed, self.tally, seal, fastest)
        gate = builder.AddNamedSystem("command_gate", gating)
        if fastest is not None:
            speeds = builder.AddNamedSystem("joint_velocities", Demultiplexer([JOINTS, JOINTS]))
            builder.Connect(plant.get_state_output_port(self._arm), speeds.get_input_port())
            builder.Connect(speeds.get_output_port(1), gate.GetInputPort("joint_velocities"))
        for name in ("pusher_velocity_W", "command_time"):
            builder.Connect(gate.GetOutputPort(name), stream.GetInputPort(name))
        both = builder.AddNamedSystem("state_and_status", Multiplexer([6, 4]))
        message = builder.AddNamedSystem("state_message", SignalSender(STATE_NAMES))
        publisher = make_publisher(link.state_channel, lcmt_drake_signal, lcm, link.period, seal)
        builder.AddNamedSystem("state_publisher", publisher)
        builder.Connect(tool.get_output_port(), both.get_input_port(0))
        builder.Connect(gate.GetOutputPort("status"), both.get_input_port(1))
        builder.Connect(both.get_output_port(), message.get_input_port())
        builder.Connect(message.get_output_port(), publisher.get_input_port())
        camera, state = setup.camera, plant.get_state_output_port(parts.object_instance)
        image = AddObjectImage(builder, parts.scene_graph, camera, _SUPERSAMPLING, setup.X_WC)
        sending = ImageSender(lcm, link, camera.width, camera.height, latency, seal)
        sender = builder.AddNamedSystem("image_sender", sending)
        builder.Connect(image.GetOutputPort("rgb"), sender.get_input_port())
        outputs = {
            "object_state": state,
            "pusher_state": tool.get_output_port(),
            "tool_target": stream.GetOutputPort("desired_state"),
            "arm_state": plant.get_state_output_port(self._arm),
        }
        for name, port in outputs.items():
            builder.ExportOutput(port, name)
        if meshcat is not None:
            forces = builder.AddNamedSystem("plant_forces", PlantForces(parts))
            builder.Connect(plant.get_contact_results_output_port(), forces.get_input_port())
            AddSceneView(builder, contact, parts.scene_graph, state, forces.get_output_port(), meshcat, setup)
            meshcat.SetCameraPose(_EYE, _TARGET)
        builder.BuildInto(self)
        self.set_name("arm_driver")

    def SetPlace(self, context: Context, place: Place) -> None:
        """Put object and tool into place, at rest; before a simulator is initialized, as the motion starts there.

        Args:
            context: Context of the driver, or of the outermost diagram around it.
            place: Pose of the object and position of the tool. The tool takes the height that it keeps, if it
                keeps one.

        Raises:
            ParameterError: The arm cannot reach it.
        """
        plant = self._parts.plant
        mine = plant.GetMyMutableContextFromRoot(context)
        x, y, z = place.p_WP
        q = self.model.positions(np.array([x, y, z if self._height is None else self._height]))
        plant.SetPositions(mine, self._arm, q)
        plant.SetVelocities(mine, self._arm, np.zeros(len(q)))
        plant.SetFreeBodyPose(mine, self._parts.object, place.X_WO)
        plant.SetVelocities(mine, self._parts.object_instance, np.zeros(6))

    def draw_place(self, generator: np.random.Generator) -> Place:
        """Draws a start of the scenario that the arm can reach."""
        start = StartDistribution(self.setup)
        for _ in range(1000):
            place = start.draw(generator)
            if (np.array(self.limits.box_low) < place.p_WP).all() and (place.p_WP < self.limits.box_high).all():
                return place
        low, high = self.model.kind.reach_low, self.model.kind.reach_high
        raise ParameterError(
            f"start: got places of the pusher beyond x and y of {low} to {high} m; allowed: the arm's reach"
        )

    def tool_pose(self, context: Context) -> RigidTransform:
        """Present pose X_WP of the tool; `context` as for `SetPlace`."""
        plant = self._parts.plant
        return plant.EvalBodyPoseInWorld(plant.GetMyContextFromRoot(context), self._parts.pusher)


def arm_limits(setup: Setup, arm: ArmName = "iiwa") -> SafetyLimits:
    """Limits of the tool's motion: those of the scenario's pusher, where the arm reaches, and the arm's own.

    Raises:
        ParameterError: The arm reaches nothing of the pusher's box.
    """
    pusher, height, kind = setup.scenario.pusher, setup.scenario.start.pusher_height, ARMS[arm]
    low, high = np.maximum(pusher.low[:2], kind.reach_low), np.minimum(pusher.high[:2], kind.reach_high)
    heights = (pusher.low[2], pusher.high[2]) if moves_up(setup) else (height - _HALF_HEIGHT, height + _HALF_HEIGHT)
    return SafetyLimits(
        box_low=(float(low[0]), float(low[1]), heights[0]),
        box_high=(float(high[0]), float(high[1]), heights[1]),
        max_speed=min(pusher.max_speed, kind.max_speed),
        max_acceleration=kind.max_acceleration,
        max_image_age=setup.scenario.lcm.timeout,
        max_command_age=setup.scenario.lcm.timeout,
    )


def moves_up(setup: Setup) -> bool:
    """Return whether a task moves the pusher up and down."""
    return 2 in setup.task.axis_indices
