# SPDX-License-Identifier: MIT
"""World model W = R(g(x, a, theta), alpha) as a LeafSystem: the contact step, and surfels behind its images."""

import dataclasses
import functools

import numpy as np
import torch
from pydrake.common.value import AbstractValue
from pydrake.math import RigidTransform
from pydrake.systems.framework import BasicVector, Context, DiscreteValues, LeafSystem

from pinwm_drake.capture.pusher import pusher_surface
from pinwm_drake.errors import ParameterError, StateError, require
from pinwm_drake.physics.model import FLOOR
from pinwm_drake.physics.parameters import Parameters
from pinwm_drake.systems.cameras.surfel_images import EVEN, WorldImages
from pinwm_drake.systems.engines.engine import FLOOR_PAIR, PUSHER_PAIR, ContactForces
from pinwm_drake.systems.engines.twin.physics import WorldPhysics
from pinwm_drake.systems.ports import declare_cache, declare_image, declare_value, declare_vector, unowned
from pinwm_drake.systems.scenario.setup import Setup
from pinwm_drake.systems.scenario.start import StartDistribution

_FIELDS = tuple(item.name for item in dataclasses.fields(Parameters))


class WorldModel(LeafSystem):  # type: ignore[misc]  # pydrake has no usable types
    """World model of a twin, with W worlds.

                                ┌────────────┐
                                │            │─► object_state      (13 W): q_WO wxyz, p_WO [m], ω_WO [rad/s], v_WO [m/s]
        pusher_velocity_W       │            │─► pusher_state       (6 W): p_WP [m], v_WP [m/s]
        (3 W): v_WP [m/s]  ────►│ WorldModel │─► plant_positions     (10): p_WP, q_WO, p_WO of world 0
                                │            │─► rgb         ImageRgba8U : of world 0
                                │            │─► rgb_batch   Value[array]: (W, height, width, 4) uint8
                                │            │─► contact_forces  Value[ContactForces]
                                └────────────┘

    All vectors are in the world frame, worlds one after another. The state is discrete and updated every `period`
    seconds from t = 0 on, with the input of that moment; only `contact_forces`, those of the step that begins now,
    depends on the input directly. Images are rendered when a port is evaluated, and kept as long as the state.

    Theta and the colours of the surfels are parameters of the Context, so that a cousin is a Context: numeric ones
    `mass` (W) [kg], `inertia` (9 W) [kg m^2], about the centre of mass, `friction` and `restitution` (2 W; floor,
    pusher), `center` (3 W) [m], `spread` (3 W) and `offset` (2 W) [m] of `Parameters`, and an abstract one, the
    spherical harmonics (N, K, 3) or (W, N, K, 3). So are the poses of the cameras (7 W), q_CW wxyz and p_CW [m], and
    the lights (4 W); see `SetLight`.
    Everything that changes is in the Context: a clone, or a copy of state and parameters, goes on bit by bit as the
    original does.

    Args:
        setup: Twin, camera, periods and number of worlds.

    Raises:
        InputError: A mesh cannot be used.
    """

    def __init__(self, setup: Setup) -> None:
        super().__init__()
        scenario, twin = setup.scenario, setup.twin
        self.num_worlds = W = scenario.num_worlds
        self.physics = WorldPhysics(twin, np.array(scenario.start.q_WO), scenario.physics.steps_per_update)
        # Of a pusher that is a few pixels wide, a tenth of its radius cannot be seen.
        sections = 12 if setup.camera.height <= 64 else 24
        pusher = pusher_surface(twin.pusher, sections=sections)
        self._images = WorldImages(twin.surfels, self.physics.scene.mesh, pusher, setup.camera)
        nominal = self.physics.parameters(W)
        numbers = [values.reshape(-1).numpy() for values in nominal.tensors()]
        self._shapes = [values.shape for values in nominal.tensors()]
        self._theta = [self.DeclareNumericParameter(BasicVector(values)) for values in numbers]
        self._cameras = self.DeclareNumericParameter(BasicVector(np.tile(_numbers(setup.X_WC.inverse()), W)))
        self._lights = self.DeclareNumericParameter(BasicVector(np.tile(EVEN, W)))
        self._sh = self.DeclareAbstractParameter(AbstractValue.Make(twin.surfels.sh))
        place = StartDistribution(setup).middle()
        self._object = self.DeclareDiscreteState(np.tile(rest_state(place.X_WO), W))
        self._pusher = self.DeclareDiscreteState(np.tile([*place.p_WP, 0.0, 0.0, 0.0], W))
        self._impulse = self.DeclareDiscreteState(np.zeros(W))
        self._velocity = self.DeclareVectorInputPort("pusher_velocity_W", 3 * W)
        self.DeclarePeriodicDiscreteUpdateEvent(setup.period, 0.0, unowned(self, self._Update))
        x, theta = self.xd_ticket(), self.all_parameters_ticket()
        self._checked = declare_cache(self, "theta", self._CalcTheta, {theta})
        one, every = (
            declare_cache(self, name, functools.partial(self.TakePictures, worlds=np.arange(number)), {x, theta})
            for name, number in (("image", 1), ("images", W))
        )
        self.DeclareStateOutputPort("object_state", self._object)
        self.DeclareStateOutputPort("pusher_state", self._pusher)
        declare_vector(self, "plant_positions", 10, self._CalcPlantPositions, {x})
        camera = setup.camera
        declare_image(self, "rgb", (camera.width, camera.height), lambda mine: one.Eval(mine)[0], {one.ticket()})
        declare_value(self, "rgb_batch", object(), lambda mine: every.Eval(mine), {every.ticket()})
        seen = {x, theta, self._velocity.ticket()}
        declare_value(self, "contact_forces", ContactForces.none(), self._CalcContactForces, seen)

    def SetState(self, context: Context, object_state: np.ndarray, p_WP: np.ndarray, world: int | None = None) -> None:
        """Put objects and pushers into place; the pushers rest.

        Args:
            context: Context of this system.
            object_state: (W, 13) as the port has it, or (13,) for one world.
            p_WP: (W, 3) m, or (3,).
            world: Number of the world; None for all.

        Raises:
            StateError: A number is not finite, a quaternion not of unit norm, or there is no such world.
        """
        worlds = self._worlds(world)
        rows, p_WP = np.asarray(object_state, float).reshape(-1, 13), np.asarray(p_WP, float).reshape(-1, 3)
        if not len(rows) == len(p_WP) == worlds.stop - worlds.start:
            raise StateError(f"states of {len(rows)} objects, {len(p_WP)} pushers; allowed: of world {worlds}")
        if not (np.isfinite(rows).all() and np.isfinite(p_WP).all()):
            raise StateError(f"object_state, p_WP: got {rows.tolist()}, {p_WP.tolist()}; allowed: finite numbers")
        if np.abs(np.linalg.norm(rows[:, :4], axis=1) - 1.0).max() > 1e-6:
            raise StateError(f"q_WO: got {rows[:, :4].tolist()}; allowed: unit quaternions")
        self._rows(context.get_mutable_discrete_state(self._object).get_mutable_value())[worlds] = rows
        pushers = self._rows(context.get_mutable_discrete_state(self._pusher).get_mutable_value())
        pushers[worlds, :3], pushers[worlds, 3:] = p_WP, 0.0

    def SetObjectState(self, context: Context, X_WO: RigidTransform, V_WO: np.ndarray, world: int = 0) -> None:
        """Set an object's state; arguments as for `engine.Handle`, or with the context of an outer diagram."""
        mine = self.GetMyMutableContextFromRoot(context)
        p_WP = self._state(mine)[1]
        self.SetState(mine, rest_state(X_WO, V_WO), p_WP[world], world)

    def SetPusherPosition(self, context: Context, p_WP: np.ndarray, world: int = 0) -> None:
        """Put a pusher; arguments as for `engine.Handle`, with the context of any diagram around this system."""
        mine = self.GetMyMutableContextFromRoot(context)
        self.SetState(mine, self._state(mine)[0][world], p_WP, world)

    def SetParameters(self, context: Context, parameters: Parameters, world: int | None = None) -> None:
        """Set theta of one world (parameters of one) or of all.

        Raises:
            PinwmError: A value is out of range.
        """
        parameters.check(self.physics.scene.model)
        worlds = self._worlds(world)
        if parameters.num_worlds != worlds.stop - worlds.start:
            raise ParameterError(f"theta of {parameters.num_worlds} worlds; allowed: {worlds.stop - worlds.start}")
        for index, name in zip(self._theta, _FIELDS, strict=True):
            vector = context.get_mutable_numeric_parameter(index)
            values = vector.CopyToVector().reshape(self.num_worlds, -1)
            values[worlds] = getattr(parameters, name).reshape(parameters.num_worlds, -1).numpy()
            vector.SetFromVector(values.ravel())

    def GetParameters(self, context: Context) -> Parameters:
        """Parameters theta of all worlds, checked.

        Raises:
            PinwmError: Somebody wrote a value into the Context that is out of range.
        """
        return self._checked.Eval(context)[0]

    def SetColors(self, context: Context, sh: torch.Tensor, world: int | None = None) -> None:
        """Set the harmonics of the surfels, (N, K, 3), of one world or all, or (W, N, K, 3); they are copied.

        Raises:
            PinwmError: The shape is another one, or there is no such world.
        """
        worlds, one = self._worlds(world), tuple(self._images.surfels.sh.shape)
        fits = [one] if world is not None else [one, (self.num_worlds, *one)]
        require("sh", tuple(sh.shape), tuple(sh.shape) in fits, " or ".join(map(str, fits)))
        parameter = context.get_mutable_abstract_parameter(self._sh)
        if world is None:
            parameter.set_value(sh.detach().to(torch.float32, copy=True).contiguous())
        else:
            if parameter.get_value().ndim == 3:
                parameter.set_value(parameter.get_value().repeat(self.num_worlds, 1, 1, 1))
            # In place, as the Context alone has this tensor; through numpy, since torch would wake all its threads.
            parameter.get_value().numpy()[worlds] = sh.detach().numpy()

    def GetPusherImpulse(self, context: Context) -> np.ndarray:
        """Sums (W,) N s of the norms of the impulses from pushers to objects so far, one norm for each update."""
        return np.array(context.get_discrete_state(self._impulse).value())

    def GetColors(self, context: Context) -> torch.Tensor:
        """Harmonics of the surfels, (N, K, 3) of all worlds or (W, N, K, 3); not a copy."""
        return context.get_abstract_parameter(self._sh).get_value()

    def SetCamera(self, context: Context, X_WC: RigidTransform, world: int | None = None) -> None:
        """Set the pose of the camera, OpenCV axes, of one world or all.

        Raises:
            StateError: There is no such world.
        """
        worlds, vector = self._worlds(world), context.get_mutable_numeric_parameter(self._cameras)
        values = vector.CopyToVector().reshape(self.num_worlds, 7)
        values[worlds] = _numbers(X_WC.inverse())
        vector.SetFromVector(values.ravel())

    def SetLight(self, context: Context, light: np.ndarray, world: int | None = None) -> None:
        """Set the light of one world or all: a, and g, world axes (4,).

        A surfel with the unit normal n, on the side of the camera, is seen with a share a + g n of its colour. By
        Lambert's law g is along the way to a lamp, or to the brighter side of a room. (1, 0, 0, 0) leaves colours as
        they are, in the light that they were filmed in.

        Raises:
            StateError: There is no such world, or it is not 4 finite numbers.
        """
        worlds, vector = self._worlds(world), context.get_mutable_numeric_parameter(self._lights)
        if np.shape(light) != (4,) or not np.isfinite(light).all():
            raise StateError(f"light: got {np.asarray(light).tolist()}; allowed: 4 finite numbers")
        values = vector.CopyToVector().reshape(self.num_worlds, 4)
        values[worlds] = light
        vector.SetFromVector(values.ravel())

    def TakePictures(self, context: Context, worlds: np.ndarray) -> np.ndarray:
        """Pictures of some worlds (m,) int, as the ports have them: (m, height, width, 4) uint8; not kept."""
        state, p_WP = self._state(context)
        sh = context.get_abstract_parameter(self._sh).get_value()
        if sh.ndim == 4 and len(worlds) < self.num_worlds:
            sh = torch.from_numpy(sh.numpy()[worlds])  # torch would wake all its threads for it
        X_CW = context.get_numeric_parameter(self._cameras).value().reshape(self.num_worlds, 7)
        lights = context.get_numeric_parameter(self._lights).value().reshape(self.num_worlds, 4)
        return self._images.take(state[worlds], p_WP[worlds], sh, X_CW[worlds], lights[worlds])

    def _worlds(self, world: int | None) -> slice:
        if world is None:
            return slice(0, self.num_worlds)
        if not 0 <= world < self.num_worlds:
            raise StateError(f"world: got {world}; allowed: 0 to {self.num_worlds - 1}")
        return slice(world, world + 1)

    def _rows(self, values: np.ndarray) -> np.ndarray:
        return values.reshape(self.num_worlds, -1)

    def _state(self, context: Context) -> tuple[np.ndarray, np.ndarray]:
        """States of the objects (W, 13), and positions p_WP (W, 3) of the pushers."""
        objects = self._rows(context.get_discrete_state(self._object).value())
        return objects, self._rows(context.get_discrete_state(self._pusher).value())[:, :3]

    def _Update(self, context: Context, values: DiscreteValues) -> None:
        v_WP = self._rows(self._velocity.Eval(context))
        theta, (state, p_WP) = self._checked.Eval(context)[1], self._state(context)
        state, p_WP, impulse = self.physics.advance(theta, state, p_WP, v_WP)
        values.set_value(self._object, state.ravel())
        values.set_value(self._pusher, np.concatenate([p_WP, v_WP], axis=1).ravel())
        values.set_value(self._impulse, context.get_discrete_state(self._impulse).value() + impulse)

    def _CalcTheta(self, context: Context) -> tuple[Parameters, tuple[np.ndarray, ...]]:
        tensors = (
            torch.from_numpy(context.get_numeric_parameter(index).CopyToVector().reshape(shape))
            for index, shape in zip(self._theta, self._shapes, strict=True)
        )
        parameters = Parameters(*tensors)
        parameters.check(self.physics.scene.model)
        return parameters, tuple(values.numpy() for values in parameters.tensors())

    def _CalcPlantPositions(self, context: Context) -> np.ndarray:
        state, p_WP = self._state(context)
        return np.concatenate([p_WP[0], state[0, :7]])

    def _CalcContactForces(self, context: Context) -> ContactForces:
        state, p_WP = self._state(context)
        v_WP, theta = self._rows(self._velocity.Eval(context)), self.GetParameters(context)
        parts = [self.physics.forces(theta, state, p_WP, v_WP, world) for world in range(self.num_worlds)]
        return ContactForces(
            worlds=np.repeat(np.arange(self.num_worlds), [len(part[0]) for part in parts]),
            pairs=tuple(FLOOR_PAIR if FLOOR in name else PUSHER_PAIR for part in parts for name in part[0]),
            p_WC=np.concatenate([part[1] for part in parts]),
            f_W=np.concatenate([part[2] for part in parts]),
        )


def rest_state(X_WO: RigidTransform, V_WO: np.ndarray | None = None) -> np.ndarray:
    """State (13,) of the object from its pose and its velocity V_WO (6,), [rad/s; m/s], or at rest."""
    return np.concatenate([_numbers(X_WO), np.zeros(6) if V_WO is None else V_WO])


def _numbers(X: RigidTransform) -> np.ndarray:
    return np.concatenate([X.rotation().ToQuaternion().wxyz(), X.translation()])
