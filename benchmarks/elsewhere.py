# SPDX-License-Identifier: MIT
"""A policy in engines that are not ours: episodes in MuJoCo or Bullet, with images by Drake's VTK.

    python -m benchmarks.elsewhere POLICY [--scene SCENE] [--engine ENGINE ...] [--episodes N] [--start S]
        [--floor MU ...] [--pusher MU ...] [--latency S ...] [--lag S] [--acceleration A] [--out FILE]

Starts, observations, success and the pusher's box are those of `pinwm evaluate POLICY --scene SCENE`; object, floor and
pusher move in the other engine, with the scene's theta and the object's convex pieces. Several frictions and latencies
are tried in all their combinations.
"""

import argparse
import math
from collections.abc import Mapping
from dataclasses import replace
from itertools import product
from pathlib import Path
from typing import Any

import gymnasium
import numpy as np

from benchmarks import timing

if __name__ == "__main__":
    timing.limit_threads(1)  # before numba and torch are imported

from benchmarks.next_push.engines import scene_maker
from benchmarks.next_push.engines.rollout import Tip, rigid, twin_truth
from benchmarks.next_push.objects import StandingAnyhow
from benchmarks.results import write_json
from pinwm_drake.experiments.evaluation.contestant import read_contestant, scene_of
from pinwm_drake.experiments.requests.evaluate import EvaluateRequest
from pinwm_drake.geometry.stored_pieces import mesh_pieces
from pinwm_drake.learning.evaluation import EpisodeResult, evaluate
from pinwm_drake.learning.spec import PolicySpec
from pinwm_drake.systems.envs.delay import Delay
from pinwm_drake.systems.envs.observation import Observer
from pinwm_drake.systems.envs.policy_scene import spec_environment
from pinwm_drake.systems.envs.worlds import progress_info
from pinwm_drake.systems.scenario.setup import Setup
from pinwm_drake.systems.scenario.start import Place

ENGINES = ("bullet", "mujoco")
_PARTS = 8  # of an action that is late, of whole steps of the engines each


class ElsewhereEnv(gymnasium.Env):
    """Environment of a policy whose physics is another engine's; as `TaskEnv` in all else."""

    def __init__(
        self,
        spec: PolicySpec,
        scene: Setup,
        engine: str,
        theta: Mapping[str, float] | None = None,
        latency: float = 0.0,
        lag: float = 0.0,
        acceleration: float = math.inf,
    ) -> None:
        self.env, self._engine = spec_environment(spec, scene, "point"), engine  # for starts and images
        self.observation_space, self.action_space = self.env.observation_space, self.env.action_space
        setup = self.env.setup
        self._observer = Observer(setup, "state" if spec.observes == "state" else "rgb", spec.frames, spec.history)
        twin, self._theta = setup.twin, replace(twin_truth(setup.twin), **(theta or {}))
        hulls = tuple(np.asarray(piece.vertices) for piece in mesh_pieces(twin.mesh_path))
        self._thing = StandingAnyhow(twin.name, twin.mesh_path, twin.mesh_path, (), hulls)
        pusher = setup.scenario.pusher
        self._box, self._horizon = (np.array(pusher.low), np.array(pusher.high)), float(pusher.horizon)
        parts = _PARTS if latency or lag or math.isfinite(acceleration) else 1
        longest = self.env.run.max_translation
        late, lags = (latency, latency), (lag, lag)
        self._delay = Delay(late, self._horizon, 1, setup.task, parts, lags, acceleration, longest)

    def reset(self, *, seed: int | None = None, options: Any = None) -> tuple[Any, dict[str, Any]]:
        """Begins the episode that `TaskEnv` begins with this seed."""
        super().reset(seed=seed)
        _, info = self.env.reset(seed=seed)
        q, p = np.split(self.env.run.object_state[0, :7], [4])
        shape = self.env.setup.twin.pusher.shape
        assert shape is not None
        tip = Tip(shape, self.env.run.p_WP[0].copy())
        self._scene = scene_maker(self._engine)(self._thing, self._theta, rigid(q, p), tip)
        self._steps = 0
        self._delay.begin(0, np.random.default_rng(0))
        self._observer.forget(*self._state(), np.arange(1))
        if self._observer.needs_images:
            self._observer.begin(np.arange(1), self.env.run.images())
        return self._observe(), info

    def step(self, action: np.ndarray) -> tuple[Any, float, bool, bool, dict[str, Any]]:
        """Goes on by one action (n,) in [-1, 1]^n; there is no reward."""
        scene, run = self._scene, self.env.run
        self._observer.remember(*self._state(), np.asarray(action)[None])
        parts = self._delay(np.asarray(action)[None])
        for part in parts:
            d_W = self.env.task.translation(part, run.max_translation)[0] / len(parts)
            here, seconds = scene.p_WP, self._horizon / len(parts)
            scene.advance((np.clip(here + d_W, *self._box) - here) / seconds, seconds)
        self._steps += 1
        q, p = np.split(scene.object_state[:7], [4])
        run.place(Place(rigid(q, p), scene.p_WP))
        if self._observer.needs_images:
            self._observer.see(run.images())
        progress = self.env.task.measure(scene.object_state[None], scene.p_WP[None])
        info = progress_info(progress, 0) | {"step": self._steps, "engine": self._engine}
        return self._observe(), 0.0, info["success"], self._steps >= self.env.max_steps, info

    def _state(self) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        goal = np.zeros((1, self.env.task.goal_size))
        return self._scene.object_state[None], self._scene.p_WP[None], goal

    def _observe(self) -> Any:
        seen = self._observer.observe(*self._state()[:2])
        return {name: rows[0] for name, rows in seen.items()} if isinstance(seen, dict) else seen[0]


def main() -> None:
    """Print the successes of each engine."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("policy", help="a folder of a policy or bundle, or one that ships")
    parser.add_argument("--scene", help="that of the policy's task and object")
    parser.add_argument("--engine", nargs="+", choices=ENGINES, default=ENGINES)
    parser.add_argument("--episodes", type=int, default=100)
    parser.add_argument("--start", type=int, default=0, help="seed of the first episode")
    parser.add_argument("--floor", nargs="+", type=float, default=[None], help="friction on the floor")
    parser.add_argument("--pusher", nargs="+", type=float, default=[None], help="friction at the pusher")
    parser.add_argument("--latency", nargs="+", type=float, default=[0.0], help="delay of the actions, s")
    parser.add_argument("--lag", type=float, default=0.0, help="time constant of the pusher's velocity, s")
    parser.add_argument("--acceleration", type=float, default=math.inf, help="largest one of the pusher, m/s^2")
    parser.add_argument("--out", type=Path, help="JSON file of the results")
    given = parser.parse_args()
    contestant = read_contestant(EvaluateRequest(given.policy))
    if contestant.spec is None:
        parser.error(f"POLICY: got {given.policy}; allowed: a policy or bundle")
    scene = scene_of(contestant, EvaluateRequest(given.policy, scene=given.scene))
    rows = []
    for engine, floor, pusher, latency in product(given.engine, given.floor, given.pusher, given.latency):
        named = {"friction_floor": floor, "friction_pusher": pusher}
        theta = {name: value for name, value in named.items() if value is not None}
        env = ElsewhereEnv(contestant.spec, scene, engine, theta, latency, given.lag, given.acceleration)
        policy, seeds = contestant.make(env.env), range(given.start, given.start + given.episodes)
        found = evaluate(env, policy, seeds, progress=lambda one, engine=engine: tell(engine, one))
        low, high = found.interval
        settings = {"engine": engine, **theta, "latency": latency, "lag": given.lag}
        if math.isfinite(given.acceleration):
            settings["acceleration"] = given.acceleration
        print(
            f"{settings}: {found.successes} of {found.episodes} ({100 * low:.1f} to {100 * high:.1f} %), "
            f"{found.mean_steps:.1f} actions",
            flush=True,
        )
        rows.append(settings | {"successes": found.successes, "episodes": found.episodes, "actions": found.mean_steps})
    write_json(given.out, policy=given.policy, start=given.start, scene=scene.scenario.name, results=rows)


def tell(engine: str, one: EpisodeResult) -> None:
    """Print an episode that failed."""
    if not one.success:
        print(f"{engine}, seed {one.seed}: {one.distance:.3f} m, {one.angle:.2f} rad at the end", flush=True)


if __name__ == "__main__":
    main()
