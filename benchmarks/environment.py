# SPDX-License-Identifier: MIT
"""Steps a second of the push environments: 32 worlds of one twin, and Drake's point contact in SubprocVecEnv.

Ours is `TaskVecEnv`, 12 steps of 1/120 s an action; the other is `TaskEnv` over the station's "point" engine, in
Stable-Baselines3's SubprocVecEnv with a process for each of two CPUs. Task, observations and the policy that acts are
the same: it heads for the object, so that most steps are in contact. A round is one episode of 100 actions of ours and
a few actions of the others, mostly without a reset.
"""

import argparse
import functools
from collections.abc import Callable

from benchmarks import results, timing
from benchmarks.memory import status

if __name__ == "__main__":
    timing.limit_threads(2)  # before numba and torch are imported

import numpy as np
from stable_baselines3.common.vec_env import SubprocVecEnv, VecEnv

from pinwm_drake.cousins.cousin import CousinDraw
from pinwm_drake.systems.envs.env import TaskEnv
from pinwm_drake.systems.envs.vector import TaskVecEnv
from pinwm_drake.systems.scenario.schema import Physics, Plant, Scenario, load_scenario

SCENE = "package://pinwm_models/scenarios/push_t.scenario.yaml"
WORLDS, PROCESSES, ACTIONS, OTHERS_ACTIONS = 32, 2, 100, 5
TIME_STEP, SIZE = 1 / 120, 64
BARS = {"state": 8000, "rgb": 6000}
KINDS = {"state": "state", "rgb": "rgb_state"}  # the policy that acts needs the state
PLANT_STEPS = {"384": None, "12": TIME_STEP}
GROWTH = 5.0  # MB


class Player:
    """Player of an environment: a policy that heads for the object, with some noise."""

    def __init__(self, env: VecEnv, act: Callable[[np.ndarray, np.random.Generator], np.ndarray]) -> None:
        self.env, self._act, self._random = env, act, np.random.default_rng(0)
        env.seed(0)
        self._seen = env.reset()

    def play(self, actions: int) -> None:
        """Take a number of actions in every world."""
        for _ in range(actions):
            state = self._seen["state"] if isinstance(self._seen, dict) else self._seen
            self._seen = self.env.step(self._act(state, self._random))[0]


def heading(state: np.ndarray, random: np.random.Generator) -> np.ndarray:
    """Actions (W, 2) towards the object, with noise, by states (W, 11)."""
    # Entries 7 and 8 are the pusher in the axes of the object, 2 and 3 cosine and sine of its yaw.
    c, s, x, y = state[:, 2], state[:, 3], -state[:, 7], -state[:, 8]
    ahead = np.stack([c * x - s * y, s * x + c * y], axis=1)
    ahead /= np.maximum(np.linalg.norm(ahead, axis=1, keepdims=True), 0.1)
    return np.clip(ahead + 0.3 * random.normal(size=ahead.shape), -1, 1).astype(np.float32)


def scene(plant_step: float | None = None) -> Scenario:
    """Scenario of the T-block in both environments."""
    scenario = load_scenario(SCENE)
    scenario.physics, scenario.plant = Physics(time_step=TIME_STEP), Plant(time_step=plant_step)
    return scenario


def ours(kind: str, *, cousins: bool = False) -> Player:
    """Player of ours with 32 worlds, each one a new cousin for every episode where that is asked for."""
    env = TaskVecEnv(
        scene(),
        WORLDS,
        observation=KINDS[kind],
        task={"reward": "shaped"},
        image_size=SIZE,
    )
    if cousins:
        draw, numbers = CousinDraw(env.worlds.setup.twin, delta=0.1), iter(range(1 << 30))
        env.worlds.domain = lambda _: draw.cousin(next(numbers))
    return Player(env, heading)


def one_of_point(kind: str, plant_step: float | None) -> TaskEnv:
    """Environment that one process of SubprocVecEnv holds."""
    return TaskEnv(scene(plant_step), "point", observation=KINDS[kind], task={"reward": "shaped"}, image_size=SIZE)


def point(kind: str, plant_step: float | None) -> Player:
    """Player of Drake's point contact in two processes."""
    makers = [functools.partial(one_of_point, kind, plant_step) for _ in range(PROCESSES)]
    return Player(SubprocVecEnv(makers, start_method="spawn"), heading)


def measure(given: argparse.Namespace) -> dict:
    """Time all environments in turn."""
    players: dict[str, tuple[Player, int, int]] = {}
    for kind in KINDS:
        players[f"{kind} twin"] = ours(kind), ACTIONS, WORLDS
        players[f"{kind} cousins"] = ours(kind, cousins=True), ACTIONS, WORLDS
        for name, step in PLANT_STEPS.items():
            players[f"{kind} point {name}"] = point(kind, step), OTHERS_ACTIONS, PROCESSES
    cases = {
        name: timing.Case(functools.partial(player.play, actions), units=actions * worlds)
        for name, (player, actions, worlds) in players.items()
    }
    samples = timing.interleave(cases, given.rounds, warmup=1)
    for player, _, _ in players.values():
        player.env.close()
    return {
        "steps_per_second": {name: timing.Samples(1 / each.seconds).summary(1.0) for name, each in samples.items()},
        "ratio": {
            f"{kind} {name}": samples[f"{kind} point {name}"].over(samples[f"{kind} twin"])
            for kind in KINDS
            for name in PLANT_STEPS
        },
        "memory": memory(given.memory_steps),
    }


def memory(steps: int) -> dict:
    """Resident memory over many steps with cousins and resets, after one episode of each world."""
    player = ours("state", cousins=True)
    player.play(2 * ACTIONS)
    found = [status("VmRSS")]
    for _ in range(10):
        player.play(max(steps // WORLDS // 10, 1))
        found.append(status("VmRSS"))
    return {"steps": steps, "megabytes": [round(value, 1) for value in found]}


def table(data: dict) -> str:
    """Table of the figures, in Markdown."""
    figures = data["steps_per_second"]
    names = {"twin": "32 worlds", "cousins": "32 worlds, a new cousin an episode"}
    names |= {f"point {steps}": f"SubprocVecEnv, point contact, {steps} steps an action" for steps in PLANT_STEPS}
    rows = [[words, *(results.spread(figures[f"{kind} {name}"], 0) for kind in KINDS)] for name, words in names.items()]
    for steps in PLANT_STEPS:
        ratios = [results.spread(data["ratio"][f"{kind} {steps}"], 0) for kind in KINDS]
        rows.append([f"ratio to point contact, {steps} steps an action", *ratios])
    lines = [*results.markdown("environment | state, steps/s | 64 x 64 image, steps/s", rows), ""]
    for kind, bar in BARS.items():
        speed = figures[f"{kind} twin"]["median"]
        lines.append(f"- {kind}: steps/s {results.verdict(speed, bar, at_most=False)}.")
    grown = data["memory"]["megabytes"]
    lines.append(
        f"- Resident memory over {data['memory']['steps']:,} state steps with cousins: {grown[0]} to {grown[-1]} MB; "
        f"growth in the last nine tenths, MB: {results.verdict(grown[-1] - grown[1], GROWTH)}."
    )
    tail = f"{data['rounds']} rounds on two CPUs; other processes took {data['load']:.0f} % of the CPUs."
    return "\n".join([*lines, "", tail])


if __name__ == "__main__":
    steps = {"--memory-steps": {"type": int, "default": 1_000_000}}
    results.run("environment", __doc__ or "", measure, table, rounds=8, options=steps)
