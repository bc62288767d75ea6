"""Worlds of the push task as one differentiable function of actions: what `Worlds` does, without Drake's diagram."""

from dataclasses import dataclass

import numpy as np
import torch
from torch import Tensor

from benchmarks.short_horizon.task import TorchProgress, TorchPush
from pinwm_drake.errors import require
from pinwm_drake.physics.state import State
from pinwm_drake.physics.stepper import Stepper
from pinwm_drake.spatial.rotations import rotate
from pinwm_drake.systems.engines.twin.physics import WorldPhysics
from pinwm_drake.systems.envs.training_worlds import TrainingWorlds
from pinwm_drake.systems.scenario.start import StartDistribution
from pinwm_drake.tasks.push import PushTask


@dataclass(frozen=True, eq=False)
class Outcome:
    """Outcome of one action in W worlds, before any of them begins anew.

    Attributes:
        before: Progress before the action.
        after: Progress after it.
        seen: (W, 11) float32, state after it.
        ended: (W,) bool, worlds whose episodes are over: success, the time limit, or a failure of the physics.
    """

    before: TorchProgress
    after: TorchProgress
    seen: Tensor
    ended: Tensor


class PushWorlds:
    """W worlds of a twin, alike in theta, whose states carry gradients until `cut`.

    A world whose physics finds no solution stays where it was, without gradient, and its episode ends.

    Attributes:
        task: The task.
        failures: Number of such worlds so far.
    """

    def __init__(self, worlds: TrainingWorlds, num_worlds: int, seed: int) -> None:
        """Begins an episode in every world.

        Args:
            worlds: Scene, task and options of a training.
            num_worlds: Number of worlds, W.
            seed: Seed of the starts, 0 or more.

        Raises:
            ParameterError: The task is another one, or its worlds are not alike.
        """
        setup, options = worlds.setup, worlds.options
        task = setup.task.for_training()
        if not isinstance(task, PushTask):
            require("task", task.name, False, PushTask.name)
        require("domains", "cousins", worlds.pool is None, "none, with a delta of 0")
        scenario = setup.scenario
        self.task, self.num_worlds, self.failures = TorchPush(task), num_worlds, 0
        self._max_steps, self._longest = task.max_steps, options.max_translation
        steps = scenario.physics.steps_per_update
        physics = WorldPhysics(setup.twin, np.array(scenario.start.q_WO), steps, num_threads=1)
        self._parameters = physics.parameters(num_worlds)
        self._stepper, self._steps = Stepper(physics.scene.model, num_threads=1), steps
        self._p_OB = physics.scene.p_OB + self._parameters.center[:, 0]
        self._period = setup.period
        self._low, self._high = (torch.tensor(end[:2]).double() for end in (scenario.pusher.low, scenario.pusher.high))
        self._start, self._random = StartDistribution(setup), np.random.default_rng(seed)
        self._count = torch.zeros(num_worlds, dtype=torch.long)
        everyone = torch.ones(num_worlds, dtype=torch.bool)
        self._state = self._drawn(everyone)

    @property
    def object_state(self) -> Tensor:
        """States (W, 13) of the objects: q_WO wxyz, p_WO [m], ω_WO [rad/s], v_WO [m/s], world."""
        state = self._state
        q, omega = state.q_WB[:, 0], state.V_WB[:, 0, :3]
        arm = rotate(q, self._p_OB)
        v_WO = state.V_WB[:, 0, 3:] - torch.linalg.cross(omega, arm)
        return torch.cat([q, state.p_WB[:, 0] - arm, omega, v_WO], 1)

    @property
    def p_WP(self) -> Tensor:
        """Positions (W, 3) m of the pushers, world."""
        return self._state.p_WP

    def place(self, object_state: np.ndarray, p_WP: np.ndarray) -> None:
        """Puts every world into a state, at the beginning of an episode.

        Args:
            object_state: (W, 13), as the attribute.
            p_WP: (W, 3) m, world.
        """
        self._state = self._at_B(object_state, p_WP)
        self._count[:] = 0

    def seen(self) -> Tensor:
        """State (W, 11) float32 of the task."""
        return self.task.state(self.object_state, self.p_WP)

    def cut(self) -> None:
        """Cuts the states from all that led to them."""
        self._state = self._state.detach()

    def advance(self, action: Tensor) -> Outcome:
        """Goes on by an action (W, 2) in [-1, 1] in every world, as `Worlds.advance` does; nothing begins anew."""
        before = self.task.measure(self.object_state, self.p_WP)
        trajectory = self._stepper.rollout(
            self._parameters, self._state, self._velocity(action), record_every=self._steps, on_failure="hold"
        )
        self._state = trajectory.frame(1)
        assert trajectory.failed is not None
        self.failures += int(trajectory.failed.sum())
        self._count += 1
        object_state = self.object_state
        after = self.task.measure(object_state, self.p_WP)
        ended = after.success | trajectory.failed | (self._count >= self._max_steps)
        return Outcome(before, after, self.task.state(object_state, self.p_WP), ended)

    def begin(self, which: Tensor) -> None:
        """Begins an episode in the worlds of a mask (W,) bool; the others keep their states and gradients."""
        if not bool(which.any()):
            return
        fresh, old = self._drawn(which), self._state
        names = ("q_WB", "p_WB", "V_WB", "q_WP", "p_WP")
        pairs = ((getattr(fresh, name), getattr(old, name)) for name in names)
        self._state = State(*(torch.where(which.view(-1, *[1] * (new.ndim - 1)), new, kept) for new, kept in pairs))
        self._count[which] = 0

    def _velocity(self, action: Tensor) -> Tensor:
        """Velocities (T, W, 6) [rad/s; m/s] of the pushers, which stay in their box."""
        action = action.double()
        short = action / action.square().sum(1, keepdim=True).clamp(min=1.0).sqrt()
        p_WP = self.p_WP[:, :2]
        down, up = ((self._low - p_WP).clamp(max=0.0), (self._high - p_WP).clamp(min=0.0))
        v_WP = torch.minimum(torch.maximum(self._longest * short, down), up) / self._period
        return torch.nn.functional.pad(v_WP, (3, 1)).expand(self._steps, -1, -1)

    def _drawn(self, which: Tensor) -> State:
        """Places from the scene's distribution in the worlds of a mask (W,), and one and the same in the others."""
        places = [self._start.draw(self._random) for _ in range(int(which.sum()))]
        rows = np.zeros(len(which), int)
        rows[which.numpy()] = np.arange(len(places))
        object_state = np.array([place.object_state for place in places])[rows]
        return self._at_B(object_state, np.array([place.p_WP for place in places])[rows])

    def _at_B(self, object_state: np.ndarray, p_WP: np.ndarray) -> State:
        """State of the physics, whose bodies have their origin at the centre of mass."""
        given = torch.from_numpy(np.ascontiguousarray(object_state, float))
        q, omega = given[:, :4], given[:, 7:10]
        arm = rotate(q, self._p_OB)
        V_WB = torch.cat([omega, given[:, 10:13] + torch.linalg.cross(omega, arm)], 1)
        q_WP = torch.zeros(len(given), 4, dtype=torch.float64)
        q_WP[:, 0] = 1.0
        return State(q[:, None], (given[:, 4:7] + arm)[:, None], V_WB[:, None], q_WP, torch.from_numpy(p_WP.copy()))
