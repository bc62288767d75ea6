# SPDX-License-Identifier: MIT
"""Many worlds of one twin as a vectorised environment, for gymnasium and for Stable-Baselines3."""

from collections.abc import Iterable, Mapping, Sequence
from typing import Any

import gymnasium
import numpy as np
from gymnasium.vector import AutoresetMode, VectorEnv
from gymnasium.vector.utils import batch_space
from stable_baselines3.common.vec_env import VecEnv

from pinwm_drake.errors import ParameterError
from pinwm_drake.systems.envs.env import changed_options, row_of
from pinwm_drake.systems.envs.observation import Observation
from pinwm_drake.systems.envs.options import EnvOptions
from pinwm_drake.systems.envs.worlds import Advance, OnReset, Worlds
from pinwm_drake.systems.scenario.load import Scene
from pinwm_drake.tasks.task import Progress

_ENGINE = "twin"


class TaskVectorEnv(VectorEnv[Observation, np.ndarray, np.ndarray]):
    """`Worlds` for gymnasium; a world whose episode ends begins the next in the same step.

    `infos`: `distance`, `angle`, `success`, `step` (W,) at the end of the action, also of worlds that ended; where
    some did, `final_obs` and `final_info`, as `SyncVectorEnv` has them with AutoresetMode.SAME_STEP.

    Args:
        scene: Scene as for `Worlds`, and so are `options` and `domain`.
        num_envs: Number of worlds, W.
        changes: Single fields of `EnvOptions`, in the place of those of `options`.

    Attributes:
        worlds: The worlds, which begin episodes and advance by actions.

    Raises:
        InputError: The scene, or one of its files, cannot be used.
        ParameterError: An option is none of those allowed.
    """

    metadata = {"render_modes": [], "autoreset_mode": AutoresetMode.SAME_STEP}  # noqa: RUF012  # as gymnasium has it

    def __init__(
        self,
        scene: Scene = "push_t",
        num_envs: int = 32,
        options: EnvOptions | None = None,
        *,
        domain: OnReset | None = None,
        **changes: Any,
    ) -> None:
        changes.pop("render_mode", None)
        self.worlds = Worlds(scene, _ENGINE, num_envs, changed_options(options, changes), domain=domain)
        self.num_envs = num_envs
        self.single_observation_space = self.worlds.observation_space
        self.single_action_space = self.worlds.action_space
        self.observation_space = batch_space(self.single_observation_space, num_envs)
        self.action_space = batch_space(self.single_action_space, num_envs)

    def reset(
        self, *, seed: int | Sequence[int | None] | None = None, options: dict[str, Any] | None = None
    ) -> tuple[Observation, dict[str, Any]]:
        """Begins an episode in every world.

        Args:
            seed: Seed of the first world, where world k takes `seed + k`; or one for each world; None goes on with the
                generators.
            options: Options as for `TaskEnv.reset`, alike in all worlds.
        """
        seeds = [int(seed) + world for world in range(self.num_envs)] if isinstance(seed, int | np.integer) else seed
        observation = self.worlds.reset(seeds, None if options is None else [options] * self.num_envs)
        return observation, _columns(self.worlds.progress, np.zeros(self.num_envs, int))

    def step(self, actions: np.ndarray) -> tuple[Observation, np.ndarray, np.ndarray, np.ndarray, dict[str, Any]]:
        """Goes on by one action each, (W, n) in [-1, 1]^n."""
        out = self.worlds.advance(actions)
        infos = _columns(out.progress, out.steps)
        observation, last = _go_on(self.worlds, out)
        for row, world in enumerate(out.ended.tolist()):
            final = {"final_obs": row_of(last, row), "final_info": out.info(world, _ENGINE)}
            infos = self._add_info(infos, final, world)
        return observation, out.reward, out.terminated, out.truncated, infos


class TaskVecEnv(VecEnv):
    """`Worlds` for Stable-Baselines3; a world whose episode ends begins the next in the same step.

    `infos` of a world at the end of an episode: those of `TaskEnv`, `terminal_observation`, `TimeLimit.truncated` and,
    for SB3's log, `episode` and `is_success`; before that they are empty. Arguments as for `TaskVectorEnv`; engines
    other than the twin have one world.

    Attributes:
        worlds: The worlds, which begin episodes and advance by actions.
    """

    def __init__(
        self,
        scene: Scene = "push_t",
        num_envs: int = 32,
        options: EnvOptions | None = None,
        *,
        domain: OnReset | None = None,
        engine: str = _ENGINE,
        **changes: Any,
    ) -> None:
        self.worlds = Worlds(scene, engine, num_envs, changed_options(options, changes), domain=domain)
        self.render_mode = None
        super().__init__(num_envs, self.worlds.observation_space, self.worlds.action_space)
        self._next = np.zeros((num_envs, self.worlds.task.action_size))
        self._sums = np.zeros(num_envs)

    def reset(self) -> Observation:
        """Begins an episode in every world, with the seeds and options that were set for it."""
        observation = self.worlds.reset(self._seeds, self._options)
        self._reset_seeds()
        self._reset_options()
        self._sums[:] = 0.0
        return observation

    def step_async(self, actions: np.ndarray) -> None:
        """Keep the actions (W, n) in [-1, 1]^n for `step_wait`."""
        self._next = actions

    def step_wait(self) -> tuple[Observation, np.ndarray, np.ndarray, list[dict[str, Any]]]:
        """Goes on by the actions of `step_async`; gives observation, rewards (W,), ends (W,) bool, and infos."""
        out = self.worlds.advance(self._next)
        observation, last = _go_on(self.worlds, out)
        self._sums += out.reward
        infos: list[dict[str, Any]] = [{} for _ in range(self.num_envs)]
        for row, world in enumerate(out.ended.tolist()):
            infos[world] = out.info(world, self.worlds.engine) | {
                "terminal_observation": row_of(last, row),
                "TimeLimit.truncated": bool(out.truncated[world]),
                "is_success": bool(out.progress.success[world]),
                "episode": {"r": float(self._sums[world]), "l": int(out.steps[world]), "t": 0.0},
            }
        self._sums[out.ended] = 0.0
        return observation, out.reward.astype(np.float32), out.terminated | out.truncated, infos

    def get_state(self) -> dict[str, np.ndarray]:
        """Everything that changes in the worlds, for `set_state`."""
        return self.worlds.get_state() | {"sums": self._sums.copy()}

    def set_state(self, arrays: Mapping[str, np.ndarray]) -> None:
        """Restores the arrays of `get_state`; seeds and options that wait for a reset are dropped."""
        self._reset_seeds()
        self._reset_options()
        self._sums = arrays["sums"].copy()
        self.worlds.set_state(arrays)

    def close(self) -> None:
        """Do nothing: the worlds hold nothing that has to be closed."""

    def get_attr(self, attr_name: str, indices: Any = None) -> list[Any]:
        """Value of an attribute of the worlds, once for each of `indices`."""
        if attr_name == "render_mode":
            return [None for _ in self._get_indices(indices)]
        return [getattr(self.worlds, attr_name) for _ in self._get_indices(indices)]

    def set_attr(self, attr_name: str, value: Any, indices: Any = None) -> None:
        """Set an attribute of all worlds; raise ParameterError for some of them."""
        self._require_all(indices)
        setattr(self.worlds, attr_name, value)

    def env_method(self, method_name: str, *method_args: Any, indices: Any = None, **method_kwargs: Any) -> list[Any]:
        """Call a method of all worlds, once; raise ParameterError for some of them."""
        self._require_all(indices)
        return [getattr(self.worlds, method_name)(*method_args, **method_kwargs)] * self.num_envs

    def env_is_wrapped(self, wrapper_class: type[gymnasium.Wrapper], indices: Any = None) -> list[bool]:
        """Flag for each of `indices`: no world is wrapped."""
        return [False for _ in self._get_indices(indices)]

    def _require_all(self, indices: Iterable[int] | int | None) -> None:
        if len(list(self._get_indices(indices))) != self.num_envs:
            raise ParameterError(f"indices: got {indices}; allowed: None, as the worlds are one object")


def _go_on(worlds: Worlds, out: Advance) -> tuple[Observation, Observation | None]:
    """Begins the next episode where one ended; gives the observation of all worlds, and the last one of those ended."""
    last, ended = None, out.ended
    if len(ended):
        last = worlds.observe(ended)
        worlds.begin(ended)
    return worlds.observe(), last


def _columns(progress: Progress, steps: np.ndarray) -> dict[str, Any]:
    columns = progress.distance, progress.angle, progress.success, steps
    infos: dict[str, Any] = dict(zip(("distance", "angle", "success", "step"), columns, strict=True))
    return infos | {f"_{name}": np.ones(len(steps), bool) for name in infos}
