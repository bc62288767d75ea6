# SPDX-License-Identifier: MIT
"""Contestants of an evaluation by name: a trained policy, a bundle, the model-predictive controller, or chance."""

import dataclasses
import hashlib
import json
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
from gymnasium import spaces

from pinwm_drake.errors import InputError
from pinwm_drake.experiments.evaluation.formats import find_format
from pinwm_drake.experiments.requests.evaluate import MPC, RANDOM, EvaluateRequest
from pinwm_drake.learning.evaluation import Acts
from pinwm_drake.learning.policy import POLICY_FILE, read_policy, weights_digest
from pinwm_drake.learning.spec import PolicySpec
from pinwm_drake.models import policy_path, shipped_policies
from pinwm_drake.reading.contents import read_bytes
from pinwm_drake.systems.envs import policy_scene
from pinwm_drake.systems.envs.env import TaskEnv
from pinwm_drake.systems.envs.options import EnvOptions, environment_setup
from pinwm_drake.systems.runs.realism.stand_in import StandIn
from pinwm_drake.systems.scenario.load import load_setup, scene_hash
from pinwm_drake.systems.scenario.setup import Setup
from pinwm_drake.systems.scenario.start import with_start_yaw
from pinwm_drake.tasks import DEFAULT_TASK
from pinwm_drake.tasks.registry import recipe_of


class RandomActions:
    """Policy that draws from the environment's action space, which an episode's seed has seeded."""

    def __init__(self, space: spaces.Space) -> None:
        """Take the action space of the environment."""
        self._space = space

    def predict(
        self, observation: Any, state: Any = None, episode_start: Any = None, deterministic: bool = True
    ) -> tuple[np.ndarray, Any]:
        """Random action (n,), whatever the observation is; see `Acts.predict`."""
        return np.asarray(self._space.sample()), None


@dataclasses.dataclass(frozen=True, eq=False)
class Contestant:
    """Policy or controller that is evaluated.

    Attributes:
        kind: "policy", "bundle", "mpc" or "random".
        identity: Text that tells this contestant from others: a hash, or "random".
        spec: Specification of a policy or bundle; None for the others.
        provenance: Origin as plain data: the training's; for "mpc", name and theta of the scene it plans with.
        make: Gives the policy for an environment.
        folder: Folder of the policy or bundle.
    """

    kind: str
    identity: str
    spec: PolicySpec | None
    provenance: dict[str, Any]
    make: Callable[[TaskEnv], Acts]
    folder: Path = Path()

    @property
    def observes(self) -> str:
        """Kind of observation that it acts on: "rgb" or "state"."""
        return "state" if self.spec is None else self.spec.observes


def read_contestant(request: EvaluateRequest) -> Contestant:
    """Read the policy or bundle that a request names, or make the contestant of the name "mpc" or "random".

    Raises:
        InputError: There is no such policy or bundle, or a file of it cannot be used.
    """
    if request.policy == RANDOM:
        return Contestant(RANDOM, RANDOM, None, {}, lambda env: RandomActions(env.action_space))
    if request.policy == MPC:
        return _mpc(request)
    from pinwm_drake.learning.bundle import is_bundle, read_bundle

    ships = request.policy in shipped_policies()
    folder = policy_path(request.policy) if ships else Path(request.policy)
    if (folder / POLICY_FILE).is_file():
        policy = read_policy(folder)
        spec = json.dumps(policy.spec.to_document(), sort_keys=True)
        identity = hashlib.sha256(f"{weights_digest(policy)}{spec}".encode()).hexdigest()
        return Contestant("policy", identity, policy.spec, policy.provenance, lambda env: policy, folder)
    if (found_format := find_format(folder)) is not None:
        document, method = found_format
        other = method.read(folder)
        identity = _digest(document, folder / method.weights)
        return Contestant("policy", identity, other.spec, other.provenance, lambda env: other, folder)
    if folder.is_dir() and is_bundle(folder):
        bundle = read_bundle(folder)
        return Contestant("bundle", bundle.sha256, bundle.spec, bundle.provenance, lambda env: bundle, folder)
    found = f"a folder without {POLICY_FILE}" if folder.is_dir() else "no such folder"
    raise InputError(
        folder, value=found, allowed=f"a policy, a bundle, {', '.join([*shipped_policies(), MPC])} or {RANDOM}"
    )


def _digest(*paths: Path) -> str:
    """SHA-256 of files, one after the other."""
    digest = hashlib.sha256()
    for path in paths:
        digest.update(read_bytes(path))
    return digest.hexdigest()


def scene_of(contestant: Contestant, request: EvaluateRequest) -> Setup:
    """Scene of an evaluation: the one that is named; else a policy's own, or that of the task.

    Raises:
        InputError: There is no such scene, or one of its files cannot be used.
        ParameterError: The scene has another object, pusher or floor than the policy was trained with, and the request
            does not ask for it; or there is no such task.
    """
    if contestant.spec is None:
        return load_setup(request.scene or recipe_of(request.task or DEFAULT_TASK).scene)
    force = None if request.other_object else policy_scene.OTHER_OBJECT
    return policy_scene.policy_setup(contestant.spec, contestant.provenance, contestant.folder, request.scene, force)


def station_of(request: EvaluateRequest) -> StandIn | None:
    """Stand-in for a robot in which the episodes run; None for the scene as it is believed to be."""
    return StandIn() if request.stand_in else None


def delays_of(contestant: Contestant, request: EvaluateRequest) -> tuple[float, float]:
    """Least and largest time after which actions take effect, s: one that is drawn for each episode.

    It is the stand-in's own where there is one; else the one that is asked for, or that of a policy's training where
    actions were never at once, or 0.
    """
    station, given = station_of(request), request.latency
    if station is not None:
        return station.latency, station.latency
    if given is not None:
        return given, given
    return _if_never(None if contestant.spec is None else contestant.spec.latency)


def lags_of(contestant: Contestant) -> tuple[float, float]:
    """Least and largest lag of the pusher's velocity, s: that of a policy's training where it was never 0, or 0."""
    return _if_never(None if contestant.spec is None else contestant.spec.lag)


def _if_never(trained: tuple[float, float] | None) -> tuple[float, float]:
    """Range that a policy was trained with, s, where 0 is not in it; else 0."""
    return trained if trained is not None and trained[0] > 0.0 else (0.0, 0.0)


def make_environment(contestant: Contestant, request: EvaluateRequest, models: Path) -> TaskEnv:
    """Make the environment that an evaluation runs in.

    Args:
        contestant: Policy or controller that acts.
        request: What is asked for.
        models: Folder for meshes of a stand-in, which the environment's setup names.

    Raises:
        InputError: The scene, or one of its files, cannot be used.
        ParameterError: An option is out of range, or the scene is not one that the policy is made for.
    """
    spec = contestant.spec
    setup = scene_of(contestant, request)
    if request.yaw is not None:
        setup = with_start_yaw(setup, request.yaw, None if spec is None else spec.task.goal_yaw)
    named = {name: getattr(request, name) for name in ("tolerance", "turn_tolerance")}
    task = {name: value for name, value in named.items() if value is not None}
    station, latency = station_of(request), delays_of(contestant, request)
    truth = None if station is None else lambda believed: station.true_scene(believed, models)
    if spec is None:
        task |= {} if request.task is None else {"name": request.task}
        options = EnvOptions(
            task=task, max_steps=request.max_steps, max_translation=request.max_translation, latency=latency
        )
        if request.max_translation is None:
            usual = recipe_of(options.task_in(setup)).max_translation
            options = dataclasses.replace(options, max_translation=usual)
        return TaskEnv(setup if truth is None else truth(setup), request.engine, options)
    steps: dict[str, Any] = {} if request.max_steps is None else {"max_steps": request.max_steps}
    late = {"latency": latency, "lag": lags_of(contestant)}
    env = policy_scene.spec_environment(spec, setup, request.engine, truth=truth, task=task, **late, **steps)
    if station is not None:
        env.worlds.spoil = station.spoil()
    return env


def _model(request: EvaluateRequest) -> Setup:
    """Return the scene that a controller plans in: that of the evaluation, or with the twin `request.model`."""
    scene = request.scene or recipe_of(request.task or DEFAULT_TASK).scene
    if request.model is None:
        return load_setup(scene)
    planner = recipe_of(request.task or DEFAULT_TASK).planner
    model = load_setup(request.model)
    if planner == "sampling" and Path(request.model).is_dir():  # it plans in the worlds of the evaluation's scene
        model = load_setup(scene, twin=request.model)
    if not request.other_object:
        policy_scene.require_same_object(f"--model {request.model}", model, scene, load_setup(scene))
    return model


def _mpc(request: EvaluateRequest) -> Contestant:
    """Contestant of the task's model-predictive controller, which plans with a scene's parameters, true or not."""
    from pinwm_drake.systems.mpc.policy import PushMpcPolicy
    from pinwm_drake.systems.mpc.sampling import SamplingMpc

    planners: dict[str, Callable[..., Acts]] = {"outline": PushMpcPolicy, "sampling": SamplingMpc}
    known = environment_setup(_model(request))
    theta = {name: float(estimate.value) for name, estimate in known.twin.theta.items()}

    def make(env: TaskEnv) -> Acts:
        return planners[recipe_of(env.task).planner](known, env.task, env.run.max_translation)

    return Contestant(MPC, scene_hash(known), None, {"model": known.scenario.name, "theta": theta}, make)
