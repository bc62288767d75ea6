# SPDX-License-Identifier: MIT
"""Steps a second of the flip environment beside MuJoCo: 32 worlds of a lying mug, two threads, the same substeps.

    python -m benchmarks flip

Ours is `TaskVecEnv` of the scenario `flip_mug` as trainings have it: observation, reward and resets with it, with the
state and with images. MuJoCo is `mujoco.rollout` on two threads with a pool that is kept, on the same pieces of the
mug, with the same masses, frictions and time step, without observation or reward. The pusher heads for the object in
both, with noise; an episode is 25 actions.
"""

import argparse
import functools

from benchmarks import results, timing

if __name__ == "__main__":
    timing.limit_threads(2)  # before numba and torch are imported

import mujoco
import numpy as np
from mujoco.rollout import Rollout

from benchmarks.environment import Player
from benchmarks.scenes.mujoco_xml import poked_model, pusher
from pinwm_drake.geometry.stored_pieces import mesh_pieces
from pinwm_drake.systems.envs.training_worlds import TrainingWorlds, training_options
from pinwm_drake.systems.scenario.start import StartDistribution
from pinwm_drake.systems.sdf.twin import twin_solid
from pinwm_drake.tasks.recipes.flip import FLIP

SCENE, WORLDS, THREADS, EPISODE = "flip_mug", 32, 2, 25
KINDS = {"state": "state", "rgb": "rgb_state"}  # the policy that acts needs the state
BARS = {"mujoco": 1.0, "images": 4 / 3}
LONGEST = FLIP.max_translation or 0.1  # m, of an action
GAIN = 1e6  # N s/m, of the actuators that hold the pusher's velocity


def heading(away: np.ndarray, random: np.random.Generator) -> np.ndarray:
    """Actions (W, 3) towards the object, with noise, by where the pusher is from it (W, 3) [m]."""
    ahead = -away / np.maximum(np.linalg.norm(away, axis=1, keepdims=True), 0.01)
    return np.clip(ahead + 0.3 * random.normal(size=away.shape), -1, 1).astype(np.float32)


class Theirs:
    """Player of MuJoCo's worlds."""

    def __init__(self, worlds: TrainingWorlds) -> None:
        setup, horizon = worlds.setup, worlds.setup.scenario.pusher.horizon
        theta, shape, solid = setup.twin.theta, setup.twin.pusher.shape, twin_solid(setup.twin)
        assert shape is not None
        self.steps, self.speed = round(horizon / setup.twin.time_step), LONGEST / horizon
        tip = pusher("sphere", shape.radius, 0.0, theta["friction_pusher"].value)
        held = "".join(f'<velocity joint="slide{k}" kv="{GAIN:g}"/>' for k in range(3))
        self.model = poked_model(
            mesh_pieces(setup.twin.mesh_path),
            (solid.mass, solid.p_OB, np.diag(solid.inertia)),
            tip,
            setup.twin.time_step,
            friction=theta["friction_floor"].value,
            option='integrator="implicitfast"',
            more=f"<actuator>{held}</actuator>",
        )
        self._datas = [mujoco.MjData(self.model) for _ in range(THREADS)]
        self._rollout = Rollout(nthread=THREADS)
        self._random, self._starts, self._action = np.random.default_rng(0), StartDistribution(setup), 0
        self._states = np.zeros((WORLDS, mujoco.mj_stateSize(self.model, mujoco.mjtState.mjSTATE_FULLPHYSICS)))
        self.moved = 0.0

    def play(self, actions: int) -> None:
        """Take a number of actions in every world."""
        positions = slice(1, 1 + self.model.nq)  # after the time
        for _ in range(actions):
            if self._action % EPISODE == 0:
                self._states[:] = 0.0
                for w in range(WORLDS):
                    place = self._starts.draw(self._random)
                    q = place.X_WO.rotation().ToQuaternion().wxyz()
                    self._states[w, positions] = [*place.X_WO.translation(), *q, *place.p_WP]
            p_WO, p_WP = self._states[:, 1:4].copy(), self._states[:, 8:11]
            command = self.speed * heading(p_WP - p_WO, self._random).astype(float)
            control = np.repeat(command[:, None], self.steps, axis=1)
            states, _ = self._rollout.rollout(self.model, self._datas, self._states, control)
            self._states = states[:, -1].copy()
            self.moved += float(np.linalg.norm(self._states[:, 1:4] - p_WO, axis=1).mean())
            self._action += 1


def measure(given: argparse.Namespace) -> dict:
    """Time all players in turn."""
    worlds = TrainingWorlds(SCENE, training_options(), num_worlds=WORLDS)

    def act(state: np.ndarray, random: np.random.Generator) -> np.ndarray:
        return heading(0.1 * state[:, 15:18], random)

    players: dict = {kind: Player(worlds.worlds(KINDS[kind]), act) for kind in KINDS} | {"mujoco": Theirs(worlds)}
    cases = {
        name: timing.Case(functools.partial(player.play, EPISODE), units=EPISODE * WORLDS)
        for name, player in players.items()
    }
    samples = timing.interleave(cases, given.rounds, warmup=1)
    assert players["mujoco"].moved > 1.0  # m, of the object in all episodes: the pusher meets it
    return {
        "substeps": players["mujoco"].steps,
        "steps_per_second": {name: timing.Samples(1 / one.seconds).summary(1.0) for name, one in samples.items()},
        "ratio": {
            "mujoco": samples["state"].over(samples["mujoco"]),
            "images": samples["rgb"].over(samples["state"]),
        },
    }


def table(data: dict) -> str:
    """Table of the figures, in Markdown."""
    names = {
        "state": "ours, state",
        "rgb": "ours, three 64 x 64 images and the state",
        "mujoco": "MuJoCo, without observation",
    }
    rows = [[words, results.spread(data["steps_per_second"][name], 0)] for name, words in names.items()]
    lines = results.markdown("environment | steps/s", rows)
    words = {"mujoco": "time of ours / MuJoCo", "images": "time with images / with the state"}
    lines += ["", *(f"- {words[n]}: {results.verdict(data['ratio'][n]['median'], bar)}." for n, bar in BARS.items())]
    load = f"other processes took {data['load']:.0f} % of them."
    tail = f"{data['substeps']} substeps an action; {data['rounds']} rounds on two CPUs; {load}"
    return "\n".join([*lines, "", tail])


if __name__ == "__main__":
    results.run("flip", __doc__ or "", measure, table, rounds=8)
