"""Errors of a twin after one random action: how far its object is from that of a plant that began in the same state.

    python -m benchmarks.one_step SCENE [--twin TWIN] [--engine ENGINE] [--draws N] [--seed S]

Object and pusher begin as the scene draws them; the action is one of full length towards a random point of the box
around the object; actions that miss it do not count. Compared are the poses of the object when the action ends, while
it still moves. The plant has SCENE's theta. The twin is another one that takes the object's place, such as an
identified one; without --twin it is the scene's, so that what is left is the difference of the engines.
"""

import argparse

import numpy as np

from benchmarks import timing

timing.limit_threads(1)  # before numba and torch are imported

from pinwm_drake.systems.crosscheck.difference import angles_between  # noqa: E402
from pinwm_drake.systems.envs.env import TaskEnv  # noqa: E402
from pinwm_drake.systems.envs.options import EnvOptions  # noqa: E402
from pinwm_drake.systems.scenario.load import load_setup  # noqa: E402
from pinwm_drake.systems.scenario.start import StartDistribution  # noqa: E402

_TOUCHED = 1e-3  # m, that an object moves at least where the pusher met it


def main() -> None:
    """Prints medians, means and the 95th percentiles of both errors."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("scene")
    parser.add_argument("--twin")
    parser.add_argument("--engine", default="hydroelastic", choices=("hydroelastic", "point", "twin"))
    parser.add_argument("--draws", type=int, default=200)
    parser.add_argument("--seed", type=int, default=0)
    given = parser.parse_args()
    found = errors(given.scene, given.twin, given.engine, given.draws, given.seed)
    for name, unit, values in zip(("translation", "rotation"), ("mm", "rad"), found.T * [[1e3], [1.0]], strict=True):
        mean, median, high = values.mean(), np.median(values), np.quantile(values, 0.95)
        print(f"{name}: mean {mean:.3g} {unit}, median {median:.3g} {unit}, 95th percentile {high:.3g} {unit}")


def errors(scene: str, twin: str | None, engine: str, draws: int, seed: int) -> np.ndarray:
    """Translation [m] and rotation [rad] errors (draws, 2)."""
    true = load_setup(scene)
    setups = (load_setup(scene) if twin is None else load_setup(scene, twin=twin), true)
    envs = [TaskEnv(setup, name, EnvOptions()) for setup, name in zip(setups, ("twin", engine), strict=True)]
    start, generator, rows = StartDistribution(true), np.random.default_rng(seed), []
    while len(rows) < draws:
        place = start.draw(generator)
        vertices_W = start.vertices @ place.X_WO.rotation().matrix().T + place.X_WO.translation()
        target = generator.uniform(vertices_W.min(0), vertices_W.max(0))
        action = (target - place.p_WP) / np.linalg.norm(target - place.p_WP)
        states = []
        for env in envs:
            env.reset(seed=0, options={"X_WO": place.X_WO, "p_WP": place.p_WP})
            env.step(action[env.worlds.task.axis_indices].astype(np.float32))
            states.append(env.worlds.run.object_state[0].copy())
        ours, theirs = states
        if np.linalg.norm(theirs[4:7] - place.X_WO.translation()) < _TOUCHED:
            continue
        q, other = (state[:4] / np.linalg.norm(state[:4]) for state in states)
        rows.append((float(np.linalg.norm(ours[4:7] - theirs[4:7])), float(angles_between(q, other))))
    return np.array(rows)


if __name__ == "__main__":
    main()
