"""Errors of a twin after one random action: how far its object is from that of a plant that began in the same state."""

import numpy as np
from pydrake.math import RigidTransform

from pinwm_drake.systems.crosscheck.difference import angles_between
from pinwm_drake.systems.envs.env import TaskEnv
from pinwm_drake.systems.envs.options import EnvOptions
from pinwm_drake.systems.scenario.load import load_setup
from pinwm_drake.systems.scenario.start import StartDistribution

_TOUCHED = 1e-3  # m, that an object moves at least where the pusher met it


def one_step_errors(scene: str, twin: str | None, engine: str, draws: int, seed: int) -> np.ndarray:
    """Translation [m] and rotation [rad] errors (draws, 2) of a twin, against a plant.

    Object and pusher begin as the scene draws them; the action is one of full length towards a random point of the box
    around the object; actions that miss it do not count. Compared are the poses of the object when the action ends,
    while it still moves, by their way from the start: an object whose mesh is not the plant's begins as high as it
    rests.

    Args:
        scene: Scene whose theta the plant has; see `load_setup`.
        twin: Folder of a twin that takes the object's place; None for the scene's own, so that what is left is the
            difference of the engines.
        engine: "hydroelastic" or "point", the plant; or "twin".
        draws: Number of actions.
        seed: Seed of starts and actions.

    Raises:
        PinwmError: A scene or twin cannot be used.
    """
    true = load_setup(scene)
    setups = (load_setup(scene) if twin is None else load_setup(scene, twin=twin), true)
    floor, own = true.twin.floor_height, [(StartDistribution(one).vertices, one.twin.floor_height) for one in setups]
    envs = [TaskEnv(setup, name, EnvOptions()) for setup, name in zip(setups, ("twin", engine), strict=True)]
    start, generator = StartDistribution(true), np.random.default_rng(seed)
    rows: list[tuple[float, float]] = []
    while len(rows) < draws:
        place = start.draw(generator)
        vertices_W = start.vertices @ place.X_WO.rotation().matrix().T + place.X_WO.translation()
        p_WO = place.X_WO.translation()
        target = generator.uniform(vertices_W.min(0), vertices_W.max(0))
        action = (target - place.p_WP) / np.linalg.norm(target - place.p_WP)
        states = []
        for env, (vertices, level) in zip(envs, own, strict=True):
            height = vertices_W[:, 2].min() - floor + level - (vertices @ place.X_WO.rotation().matrix().T)[:, 2].min()
            X_WO = RigidTransform(place.X_WO.rotation(), [*p_WO[:2], height])
            env.reset(seed=0, options={"X_WO": X_WO, "p_WP": place.p_WP})
            env.step(action[env.worlds.task.axis_indices].astype(np.float32))
            state = env.worlds.run.object_state[0].copy()
            state[4:7] -= X_WO.translation()
            states.append(state)
        ours, theirs = states
        if np.linalg.norm(theirs[4:7]) < _TOUCHED:
            continue
        q, other = (state[:4] / np.linalg.norm(state[:4]) for state in states)
        rows.append((float(np.linalg.norm(ours[4:7] - theirs[4:7])), float(angles_between(q, other))))
    return np.array(rows)
