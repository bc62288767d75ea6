# SPDX-License-Identifier: MIT
"""Errors of predictions after one random action: of twins, and of a model that imagines images."""

from dataclasses import dataclass, replace
from typing import Any

import numpy as np
import torch
from pydrake.common.eigen_geometry import Quaternion
from pydrake.math import RigidTransform, RotationMatrix
from scipy.spatial.transform import Rotation

from pinwm_drake.capture.pusher import pusher_surface
from pinwm_drake.checkpoints import ArrayFile
from pinwm_drake.geometry.meshes import load_mesh
from pinwm_drake.identification.picture_pose import PictureReader
from pinwm_drake.paper.baselines.dreamer.episodes import Batch
from pinwm_drake.paper.baselines.dreamer.world_model import WorldModel
from pinwm_drake.spatial.poses import Pose
from pinwm_drake.systems.crosscheck.difference import angles_between
from pinwm_drake.systems.envs.env import TaskEnv
from pinwm_drake.systems.envs.options import EnvOptions
from pinwm_drake.systems.envs.training_worlds import training_options
from pinwm_drake.systems.runs.rest import is_slow
from pinwm_drake.systems.scenario.load import load_setup
from pinwm_drake.systems.scenario.setup import Setup
from pinwm_drake.systems.scenario.start import StartDistribution, on_floor

_REST = 5  # actions without motion, in which an object comes to rest
_TOUCHED = 1e-3  # m, that an object moves at least where the pusher met it
_TOUCHED_AT_ALL = 1e-5  # m, likewise, by whatever the pusher met


@dataclass(frozen=True, eq=False)
class Outcomes(ArrayFile):
    """Outcomes of single actions in a plant.

    Attributes:
        q_WO: (n, 4) wxyz, orientations of the object at the start.
        p_WO: (n, 3) m, world, its places.
        p_WP: (n, 3) m, world, places of the pusher.
        action: (n, action_size), in [-1, 1].
        turned: (n, 4) wxyz, turns of the object until the action ends, or until it rests after it, world.
        moved: (n, 3) m, world, ways of the object until then.
        longest: () m, longest translation of the pusher in an action, which is the unit of `action`.
    """

    work, wanted = "one-step", "outcomes of actions"

    q_WO: np.ndarray
    p_WO: np.ndarray
    p_WP: np.ndarray
    action: np.ndarray
    turned: np.ndarray
    moved: np.ndarray
    longest: np.ndarray


def plant_outcomes(scene: str, engine: str, draws: int, seed: int, *, max_translation: float | None = None) -> Outcomes:
    """Outcomes of actions of full length towards random points of the box around the object.

    Actions that miss the object do not count. Those that do not even touch it in the twin's physics are not tried in a
    plant, where each takes seconds: of a push of 30 mm, seven of eight, and of shorter ones more.

    Args:
        scene: Scene whose theta the plant has, and whose starts are drawn; see `load_setup`.
        engine: "hydroelastic" or "point"; or "twin".
        draws: Number of actions.
        seed: Seed of starts and actions.
        max_translation: m, translation of the pusher in an action; None for the longest that its speed allows.

    Raises:
        PinwmError: The scene cannot be used.
    """
    setup = load_setup(scene)
    env, twin = (TaskEnv(setup, one, EnvOptions(max_translation=max_translation)) for one in (engine, "twin"))
    start, generator = StartDistribution(setup), np.random.default_rng(seed)
    rows: list[tuple[np.ndarray, ...]] = []
    while len(rows) < draws:
        place = start.draw(generator)
        p_WO = place.X_WO.translation()
        vertices_W = start.vertices @ place.X_WO.rotation().matrix().T + p_WO
        target = generator.uniform(vertices_W.min(0), vertices_W.max(0))
        action = (target - place.p_WP) / np.linalg.norm(target - place.p_WP)
        action = action[env.worlds.task.axis_indices].astype(np.float32)
        if np.linalg.norm(_after(twin, place.X_WO, place.p_WP, action)[1]) < _TOUCHED_AT_ALL:
            continue
        turned, moved = _after(env, place.X_WO, place.p_WP, action)
        if np.linalg.norm(moved) < _TOUCHED:
            continue
        rows.append((place.X_WO.rotation().ToQuaternion().wxyz(), p_WO, place.p_WP, action, turned, moved))
    columns = [np.array(column) for column in zip(*rows, strict=True)]
    columns.append(np.array(env.worlds.run.max_translation))
    return Outcomes(*columns)


def outcomes_at_rest(scene: str, engine: str, outcomes: Outcomes, rest: int) -> Outcomes:
    """Outcomes of the same actions after which the pusher stands still until the object does, `rest` actions at most.

    Raises:
        PinwmError: The scene cannot be used.
    """
    env, rows = TaskEnv(load_setup(scene), engine, EnvOptions(max_translation=float(outcomes.longest))), []
    for k in range(len(outcomes.action)):
        X_WO = RigidTransform(RotationMatrix(Quaternion(outcomes.q_WO[k])), outcomes.p_WO[k])
        rows.append(_after(env, X_WO, outcomes.p_WP[k], outcomes.action[k], rest))
    turned, moved = (np.array(column) for column in zip(*rows, strict=True))
    return replace(outcomes, turned=turned, moved=moved)


def step_errors(setup: Setup, outcomes: Outcomes, rest: int = 0) -> np.ndarray:
    """Return the translation [m] and rotation [rad] errors (n, 2) of the twin in a scene, against a plant's outcomes.

    Compared are ways and turns of the object from rest until the action ends, while it still moves; or until it rests
    again.
    """
    env = TaskEnv(setup, "twin", EnvOptions(max_translation=float(outcomes.longest)))
    vertices = StartDistribution(setup).vertices
    rows = []
    for k in range(len(outcomes.action)):
        R_WO = RotationMatrix(Quaternion(outcomes.q_WO[k]))
        x, y = outcomes.p_WO[k, :2].tolist()
        X_WO = on_floor(vertices, R_WO, x, y, setup.twin.floor_height)
        turned, moved = _after(env, X_WO, outcomes.p_WP[k], outcomes.action[k], rest)
        angle = float(angles_between(turned, outcomes.turned[k]))
        rows.append((float(np.linalg.norm(moved - outcomes.moved[k])), angle))
    return np.array(rows)


def observed(env: TaskEnv, X_WO: RigidTransform, p_WP: np.ndarray, action: np.ndarray) -> tuple[list[Any], np.ndarray]:
    """Observations and states of the object (7, 13) at a start, after each of 5 actions of rest, and after an action.

    Args:
        env: The environment.
        X_WO: Pose of the object at the start.
        p_WP: (3,) m, world: place of the pusher.
        action: (action_size,) in [-1, 1].
    """
    seen = [env.reset(seed=0, options={"X_WO": X_WO, "p_WP": p_WP})[0]]
    states = [env.worlds.run.object_state[0].copy()]
    for one in (*[np.zeros_like(action)] * _REST, action):
        seen.append(env.step(one)[0])
        states.append(env.worlds.run.object_state[0].copy())
    return seen, np.array(states)


def motion(before: np.ndarray, after: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Turn (4,) wxyz and way (3,) m of an object between two poses, each (7 or more,) q_WO wxyz, p_WO [m]."""
    R_before, R_after = (Rotation.from_quat(np.roll(state[:4], -1)) for state in (before, after))
    return np.roll((R_after * R_before.inv()).as_quat(), 1), after[4:7] - before[4:7]


def _after(
    env: TaskEnv, X_WO: RigidTransform, p_WP: np.ndarray, action: np.ndarray, rest: int = 0
) -> tuple[np.ndarray, np.ndarray]:
    """Turn (4,) wxyz and way (3,) m of the object in an action, before which it came to rest.

    The pusher stands still after it until the object does, for `rest` actions at the most.
    """
    _, states = observed(env, X_WO, p_WP, action)
    last = states[-1]
    for _ in range(rest):
        env.step(np.zeros_like(action))
        last = env.worlds.run.object_state[0].copy()
        if is_slow(last):
            break
    return motion(states[-2], last)


@dataclass(frozen=True, eq=False)
class SeenOutcomes(ArrayFile):
    """Observations of n single actions: at the start, after each of 5 actions of rest, and after the action.

    Attributes:
        image: (n, 7, height, width, 3) uint8, RGB, white where the object is not.
        pusher: (n, 7, action_size) float32, places of the pusher across its box, -1 to 1.
        action: (n, action_size) float32 in [-1, 1], the action after the rest.
        before: (n, 7), pose of the object before the action: q_WO wxyz, p_WO [m].
        p_WP: (n, 3) m, world, places of the pusher after the action.
    """

    work, wanted = "one-step", "observations of actions"

    image: np.ndarray
    pusher: np.ndarray
    action: np.ndarray
    before: np.ndarray
    p_WP: np.ndarray

    @property
    def after(self) -> np.ndarray:
        """Images (n, height, width, 3) float32 after the action, 1 for white."""
        return self.image[:, -1].astype(np.float32) / np.float32(255.0)


def see_outcomes(scene: str, engine: str, outcomes: Outcomes) -> SeenOutcomes:
    """Observations of the actions of `plant_outcomes`, which are taken again, in the images of trainings.

    Raises:
        PinwmError: The scene cannot be used.
    """
    options = training_options(observation="rgb", frames=1, max_translation=float(outcomes.longest))
    env, rows = TaskEnv(load_setup(scene), engine, options), []
    for k in range(len(outcomes.action)):
        X_WO = RigidTransform(RotationMatrix(Quaternion(outcomes.q_WO[k])), outcomes.p_WO[k])
        seen, states = observed(env, X_WO, outcomes.p_WP[k], outcomes.action[k])
        image, pusher = (np.array([one[name] for one in seen]) for name in ("image", "pusher"))
        rows.append((image, pusher, outcomes.action[k], states[-2, :7], env.worlds.run.p_WP[0].copy()))
    return SeenOutcomes(*(np.array(column) for column in zip(*rows, strict=True)))


def imagine(model: WorldModel, seen: SeenOutcomes) -> np.ndarray:
    """Images (n, height, width, 3) float32 that a model imagines after the actions, 1 for white.

    The model sees everything up to the action; its latents are the likeliest ones.
    """
    n, steps = seen.image.shape[:2]
    action = np.zeros((n, steps, seen.action.shape[1]), np.float32)
    action[:, -1] = seen.action
    first = torch.zeros(n, steps, dtype=torch.bool)
    first[:, 0] = True
    image, pusher = torch.from_numpy(seen.image), torch.from_numpy(seen.pusher)
    nothing = torch.zeros(n, steps)
    batch = Batch(image, pusher, torch.from_numpy(action), nothing, nothing.bool(), first)
    dark = model.foresee(batch, steps - 1, mode=True)[0][:, 0]
    images: np.ndarray = (1.0 - dark).clamp(0.0, 1.0).permute(0, 2, 3, 1).contiguous().numpy()
    return images


def picture_errors(
    setup: Setup, outcomes: Outcomes, seen: SeenOutcomes, images: np.ndarray, *, num_threads: int | None = None
) -> np.ndarray:
    """Return errors (n, 2) of translation [m] and rotation [rad] of the motions that images show.

    The pose before the action is read from the plant's image as well, so that what light and outlines do to both
    readings cancels.

    Args:
        setup: Scene of the outcomes, whose object is known by its colours.
        outcomes: What the actions did in the plant.
        seen: Its observations, of which those after the action are not looked at, but for the pusher's place.
        images: (n, height, width, 3), 0 to 1, after the actions.
        num_threads: Threads of the renderer; None for one on each core.
    """
    camera = setup.camera.scaled(images.shape[1] / setup.camera.height)
    q_WC, p_WC = np.array(setup.X_WC.rotation().ToQuaternion().wxyz()), np.array(setup.X_WC.translation())
    reader = PictureReader(
        setup.twin.surfels,
        camera,
        Pose(torch.from_numpy(q_WC), torch.from_numpy(p_WC)),
        load_mesh(setup.twin.mesh_path),
        pusher_surface(setup.twin.pusher),
        level="z" not in setup.task.axes,
        reach=float(outcomes.longest),
        num_threads=num_threads,
    )
    rows = []
    for k, image in enumerate(images):
        before = seen.before[k]
        X_WO = Pose(torch.from_numpy(before[:4] / np.linalg.norm(before[:4])), torch.from_numpy(before[4:]))
        pictures = ((seen.image[k, -2] / 255.0, outcomes.p_WP[k]), (image, seen.p_WP[k]))
        X = [reader.read(picture, X_WO, p_WP, np.random.default_rng(k)) for picture, p_WP in pictures]
        turned, moved = motion(*(np.concatenate([found.q.numpy(), found.p.numpy()]) for found in X))
        angle = float(angles_between(turned, outcomes.turned[k]))
        rows.append((float(np.linalg.norm(moved - outcomes.moved[k])), angle))
    return np.array(rows)
