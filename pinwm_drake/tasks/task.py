# SPDX-License-Identifier: MIT
"""The seam between a task and the parts that are alike for all tasks: environments, training, evaluation, bundles.

A task is a frozen dataclass whose fields are plain numbers, texts and tuples, so that it can stand in a scenario, in a
policy and in a bundle. It sees W worlds at once.
"""

from abc import ABC, abstractmethod
from collections.abc import Sequence
from dataclasses import dataclass, fields
from functools import cached_property
from typing import TYPE_CHECKING, Annotated, Any, ClassVar, Literal, Self

import numpy as np
from pydantic import Field

from pinwm_drake.errors import ParameterError

if TYPE_CHECKING:  # it loads torch, which a robot's controller does without
    from pinwm_drake.spatial.poses import Pose

_AXES = ("x", "y", "z")
Reward = Literal["paper", "shaped"]
Positive = Annotated[float, Field(gt=0)]


@dataclass(frozen=True, eq=False)
class Progress:
    """State of W worlds on the way to a goal.

    Attributes:
        distance: d_t (W,) m, from the object to the goal, as the task measures it.
        angle: d_r (W,) rad, 0 to pi, between the object's orientation and the goal's.
        reach: (W,) m, from the pusher to the object's origin, as the task measures it.
        at_rest: (W,) bool, true where the object rests.
        success: (W,) bool, true where the task is done.
        astray: (W,) m, level distance of the object from the middle of the floor; None where it does not matter.
        turn: (W,) rad/s, the object's rate of turn; None where it does not matter.
    """

    distance: np.ndarray
    angle: np.ndarray
    reach: np.ndarray
    at_rest: np.ndarray
    success: np.ndarray
    astray: np.ndarray | None = None
    turn: np.ndarray | None = None


class Task(ABC):
    """One task; subclasses are frozen dataclasses that `registry.register` makes known by their names.

    Attributes:
        name: Name of the task, such as "push".
        axes: World axes along which an action moves the pusher, such as ("x", "y"); its other coordinates stay.
        state_size: Number of components of `state`.
        state_bound: Largest absolute value of a component of `state`.
        max_steps: Largest number of actions in an episode, unless an environment is told otherwise.
        errors: (state_size,) usual errors of estimates from images, of an object in motion, each more than 0: those of
            a student count in these units. Empty where all components count alike.
    """

    name: ClassVar[str]
    axes: ClassVar[tuple[str, ...]]
    state_size: ClassVar[int]
    state_bound: ClassVar[float] = 20.0
    max_steps: ClassVar[int] = 100
    errors: ClassVar[tuple[float, ...]] = ()

    @abstractmethod
    def measure(self, object_state: np.ndarray, p_WP: np.ndarray) -> Progress:
        """Distance to the goal and success of W worlds.

        Args:
            object_state: (W, 13), as the station's port has it: q_WO wxyz, p_WO [m], ω_WO [rad/s], v_WO [m/s], world.
            p_WP: (W, 3) m, world: position of the pusher.
        """

    @abstractmethod
    def rewards(self, before: Progress, after: Progress) -> np.ndarray:
        """Rewards (W,) of the actions that led from one progress to another."""

    def worth(self, progress: Progress) -> np.ndarray:
        """Worth (W,) of successes in training, 0 to 1: less where they came about as none should."""
        return np.ones(len(progress.success))

    @abstractmethod
    def state(self, object_state: np.ndarray, p_WP: np.ndarray) -> np.ndarray:
        """Observation (W, state_size) float32 of the state, for teachers, critics and planners.

        Args:
            object_state: (W, 13), as for `measure`.
            p_WP: (W, 3) m, world: position of the pusher.
        """

    def object_state(self, state: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Object's states (W, 13) and pusher's positions (W, 3) m that `state` (W, state_size) tells, for planners.

        Both are as in `measure`; a component that the state does not tell is NaN.

        Raises:
            ParameterError: The task's state does not tell them, so that nothing can be planned from it.
        """
        raise ParameterError(f"task: got {self.name}; allowed: a task whose state has the poses of object and pusher")

    @property
    def action_size(self) -> int:
        """Number of components of an action, one for each of `axes`."""
        return len(self.axes)

    @cached_property
    def axis_indices(self) -> np.ndarray:
        """Indices (action_size,) of `axes` in a vector of the world: 0 for x, 1 for y, 2 for z."""
        return np.array([_AXES.index(axis) for axis in self.axes])

    def translation(self, action: np.ndarray, longest: float) -> np.ndarray:
        """Return translations d_W (W, 3) m of the pusher, none longer than `longest`.

        Args:
            action: (W, action_size) in [-1, 1], in units of `longest`; a row that is not finite gives a zero row.
            longest: m, longest translation.
        """
        action = np.asarray(action, float).reshape(-1, self.action_size)
        action = np.where(np.isfinite(action).all(axis=1)[:, None], np.clip(action, -1.0, 1.0), 0.0)
        length = np.hypot.reduce(action, axis=1)[:, None]
        return self.along_axes(longest * action / np.maximum(length, 1.0))

    def along_axes(self, components: np.ndarray) -> np.ndarray:
        """World vectors (..., 3) with the components (..., action_size) along `axes`, and zero along the other ones."""
        vectors = np.zeros((*np.shape(components)[:-1], 3))
        vectors[..., self.axis_indices] = components
        return vectors

    def goal_pose(self, height: float) -> "Pose | None":
        """Pose X_WG of the object at the goal, for pictures; None where any of many poses will do.

        Args:
            height: m, world: z of the object's origin at the goal.
        """
        return None

    @property
    def goal_size(self) -> int:
        """Number of components of the goal that each episode draws; 0 where all episodes have that of the task."""
        return 0

    def goal_components(self) -> tuple[tuple[str, str], ...]:
        """Meaning and unit of each component of an episode's goal; none where episodes draw none."""
        return ()

    def draw_goal(self, generator: np.random.Generator) -> np.ndarray:
        """Goal (goal_size,) of an episode, in units and frame of the task's own."""
        return np.zeros(0)

    def with_goal(self, goal: np.ndarray) -> Self:
        """Return the task whose own goal is that of an episode, (goal_size,): for pictures, planners and scores."""
        return self

    def from_goal(self, object_state: np.ndarray, p_WP: np.ndarray, goal: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Object (W, 13) and pusher (W, 3) as seen from episodes' goals, moved along with these to the task's own goal.

        `measure` and `state` take what this gives.

        Args:
            object_state: (W, 13), as for `measure`.
            p_WP: (W, 3) m, world: position of the pusher.
            goal: (W, goal_size) goals of the episodes.
        """
        return object_state, p_WP

    def world_action(self, action: Any, goal: Any) -> Any:
        """Torch tensor (B, n) of actions along the world's axes, no longer than 1.

        Args:
            action: (B, n) torch tensor, as a policy acts on the state that `from_goal` leads to.
            goal: (B, goal_size) torch tensor, goals of the episodes.
        """
        return action

    @property
    def goal_yaw(self) -> float:
        """Turn [rad] of the goal about the world's z, from which ranges of starts are counted."""
        return 0.0

    def placed(self, q_WO: Sequence[float], vertices: np.ndarray, floor_height: float) -> Self:
        """Return the task of a scene's object.

        Args:
            q_WO: (4,) wxyz, orientation of the object at the start, before it is turned about z.
            vertices: (n, 3) m, frame O: vertices of its mesh.
            floor_height: m, world: z of the floor.
        """
        return self

    def moved(self, x: float, y: float) -> Self:
        """Return the task whose goal and floor are x, y [m] farther in the world.

        Raises:
            ParameterError: The task does not say how it moves.
        """
        raise ParameterError(f"task: got {self.name}; allowed: a task that can be moved, with `moved`")

    def for_training(self) -> Self:
        """Return the task with the rewards that a policy learns from."""
        return self

    def state_components(self) -> tuple[tuple[str, str], ...]:
        """Meaning and unit of each component of `state`; with the unit "0.1 m" a 1 stands for 0.1 m."""
        return tuple((f"component {k} of the state of the task {self.name}", "1") for k in range(self.state_size))

    def near_goal(self, state: np.ndarray, share: float = 1.0) -> bool:
        """Flag: a state, such as a policy's estimate, is a success but for rest, which many states have to tell.

        Args:
            state: (state_size,), as `state` gives it; false where it is not finite.
            share: Share of the tolerances that counts, less than 1 to be sure.
        """
        return False

    def to_document(self) -> dict[str, Any]:
        """Return the task as plain data, for YAML and JSON: its name and all fields."""
        values = {field.name: getattr(self, field.name) for field in fields(self)}  # type: ignore[arg-type]
        return {"name": self.name} | {key: list(v) if isinstance(v, tuple) else v for key, v in values.items()}


def lengths(vectors: np.ndarray) -> np.ndarray:
    """Lengths (W,) of vectors (W, n); numpy's norm takes three times as long for so few."""
    found: np.ndarray = np.sqrt(np.einsum("ij,ij->i", vectors, vectors))
    return found
