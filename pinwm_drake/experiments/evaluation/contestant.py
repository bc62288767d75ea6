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
    """

    kind: str
    identity: str
    spec: PolicySpec | None
    provenance: dict[str, Any]
    make: Callable[[TaskEnv], Acts]

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
        return _mpc(_model(request))
    from pinwm_drake.learning.bundle import is_bundle, read_bundle

    ships = request.policy in shipped_policies()
    folder = policy_path(request.policy) if ships else Path(request.policy)
    if (folder / POLICY_FILE).is_file():
        policy = read_policy(folder)
        spec = json.dumps(policy.spec.to_document(), sort_keys=True)
        identity = hashlib.sha256(f"{weights_digest(policy)}{spec}".encode()).hexdigest()
        return Contestant("policy", identity, policy.spec, policy.provenance, lambda env: policy)
    if (found_format := find_format(folder)) is not None:
        document, method = found_format
        other = method.read(folder)
        identity = _digest(document, folder / method.weights)
        return Contestant("policy", identity, other.spec, other.provenance, lambda env: other)
    if folder.is_dir() and is_bundle(folder):
        bundle = read_bundle(folder)
        return Contestant("bundle", bundle.sha256, bundle.spec, bundle.provenance, lambda env: bundle)
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


def usual_scene(policy: str, task: str | None) -> str:
    """Name of the scenario in which a contestant is evaluated where none is named: that of its task and object.

    Args:
        policy: The contestant, as `EvaluateRequest` has it.
        task: Name of the task of "mpc" and "random"; None for the default one.

    Raises:
        InputError: There is no such policy or bundle, or a file of it cannot be used.
        ParameterError: There is no such task.
    """
    spec = None if task is not None or policy in (MPC, RANDOM) else read_contestant(EvaluateRequest(policy)).spec
    return recipe_of(task or DEFAULT_TASK).scene if spec is None else policy_scene.usual_scene(spec)


def with_scene(request: EvaluateRequest) -> EvaluateRequest:
    """Return the request with a scene; that of its task and object where it names none."""
    if request.scene is not None:
        return request
    return dataclasses.replace(request, scene=usual_scene(request.policy, request.task))


def _scene(request: EvaluateRequest) -> str:
    scene = with_scene(request).scene
    assert scene is not None
    return scene


def station_of(request: EvaluateRequest) -> StandIn | None:
    """Stand-in for a robot in which the episodes run; None for the scene as it is believed to be."""
    return StandIn() if request.stand_in else None


def delay_of(request: EvaluateRequest) -> float:
    """Time after which actions take effect, s: the stand-in's own where there is one."""
    station = station_of(request)
    return request.latency if station is None else station.latency


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
    setup = load_setup(_scene(request))
    if request.yaw is not None:
        setup = with_start_yaw(setup, request.yaw, None if spec is None else spec.task.goal_yaw)
    named = {name: getattr(request, name) for name in ("tolerance", "turn_tolerance")}
    task = {name: value for name, value in named.items() if value is not None}
    station, delay = station_of(request), delay_of(request)
    latency = (delay, delay)
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
    env = policy_scene.spec_environment(spec, setup, request.engine, truth=truth, task=task, latency=latency, **steps)
    if station is not None:
        env.worlds.spoil = station.spoil()
    return env


def _model(request: EvaluateRequest) -> Setup:
    """Return the scene that a controller plans in: that of the evaluation, or with the twin `request.model`."""
    if request.model is None:
        return load_setup(_scene(request))
    planner = recipe_of(request.task or DEFAULT_TASK).planner
    if planner == "sampling" and Path(request.model).is_dir():  # it plans in the worlds of the evaluation's scene
        return load_setup(_scene(request), twin=request.model)
    return load_setup(request.model)


def _mpc(model: Setup) -> Contestant:
    """Contestant of the task's model-predictive controller, which plans with a scene's parameters, true or not."""
    from pinwm_drake.systems.mpc.policy import PushMpcPolicy
    from pinwm_drake.systems.mpc.sampling import SamplingMpc

    planners: dict[str, Callable[..., Acts]] = {"outline": PushMpcPolicy, "sampling": SamplingMpc}
    known = environment_setup(model)
    theta = {name: float(estimate.value) for name, estimate in known.twin.theta.items()}

    def make(env: TaskEnv) -> Acts:
        return planners[recipe_of(env.task).planner](known, env.task, env.run.max_translation)

    return Contestant(MPC, scene_hash(known), None, {"model": known.scenario.name, "theta": theta}, make)
