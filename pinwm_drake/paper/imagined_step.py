"""Errors of a model that imagines images, after one random action: poses of the object are read from its images."""

from dataclasses import dataclass

import numpy as np
import torch
from pydrake.common.eigen_geometry import Quaternion
from pydrake.math import RigidTransform, RotationMatrix

from pinwm_drake.capture.pusher import pusher_surface
from pinwm_drake.checkpoints import ArrayFile
from pinwm_drake.geometry.meshes import load_mesh
from pinwm_drake.identification.picture_pose import PictureReader
from pinwm_drake.paper.baselines.dreamer.replay import Batch
from pinwm_drake.paper.baselines.dreamer.world_model import WorldModel
from pinwm_drake.paper.one_step import Outcomes, motion, observed
from pinwm_drake.spatial.poses import Pose
from pinwm_drake.systems.crosscheck.difference import angles_between
from pinwm_drake.systems.envs.env import TaskEnv
from pinwm_drake.systems.envs.training_worlds import training_options
from pinwm_drake.systems.scenario.load import load_setup
from pinwm_drake.systems.scenario.setup import Setup


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

    Args:
        scene: Scene of the outcomes.
        engine: Their engine.
        outcomes: The starts and actions.

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
    """Translation [m] and rotation [rad] errors (n, 2) of the motions that images show, against a plant's outcomes.

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
