# SPDX-License-Identifier: MIT
"""Runs the episodes of an evaluation, in this process or shared among several."""

import math
import time
from collections.abc import Callable, Sequence
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
import torch

from pinwm_drake.errors import ParameterError
from pinwm_drake.experiments.evaluation.contestant import Contestant, make_environment, read_contestant
from pinwm_drake.experiments.evaluation.coverage import coverage
from pinwm_drake.experiments.evaluation.store import EpisodeStore
from pinwm_drake.experiments.requests.evaluate import EvaluateRequest
from pinwm_drake.files import scratch
from pinwm_drake.geometry.meshes import load_mesh
from pinwm_drake.learning.evaluation import run_episode
from pinwm_drake.parallel import Executor
from pinwm_drake.report.evaluation.episode import EpisodeRecord
from pinwm_drake.report.evaluation.report import strip_steps
from pinwm_drake.spatial.poses import Pose, pose_to_matrix

# Of a process, by what the policy is and what is asked for.
_runners: dict[tuple[str, EvaluateRequest], "EpisodeRunner"] = {}


class EpisodeRunner:
    """An environment with a policy in it.

    Attributes:
        contestant: Policy or controller that acts.
        env: The environment.
    """

    def __init__(self, contestant: Contestant, request: EvaluateRequest) -> None:
        """Make the environment.

        Raises:
            PinwmError: The scene cannot be used, or is not one that the policy is made for.
        """
        self._models = scratch()  # goes when this goes
        self.contestant = contestant
        self.env = make_environment(contestant, request, Path(self._models.name))
        self._policy = contestant.make(self.env)
        self._mesh = load_mesh(self.env.setup.twin.mesh_path)

    def run(self, seed: int) -> EpisodeRecord:
        """Run an episode, all of which follows from its seed."""
        rows: list[np.ndarray] = []
        views: list[np.ndarray] = []

        def watch(observation: Any) -> None:
            row = np.concatenate([self.env.run.object_state[0, :7], self.env.run.p_WP[0]])
            # Where the physics failed, nothing has happened.
            rows.append(row if np.isfinite(row).all() or not rows else rows[-1])
            if isinstance(observation, dict):
                views.append(observation["image"][..., -3:])

        begun, cpu = time.perf_counter(), time.process_time()
        result = run_episode(self.env, self._policy, seed, watch=watch)
        seconds, cpu = time.perf_counter() - begun, time.process_time() - cpu
        table = np.array(rows)
        goal = self.env.worlds.goal[0]
        result = replace(result, coverage=self._coverage(table[-1], goal))
        at = np.array(strip_steps(len(rows) - 1) if views else [], int)
        shown = np.array([views[step] for step in at]) if views else np.zeros((0, 0, 0, 3), np.uint8)
        return EpisodeRecord(result, table[:, :4], table[:, 4:7], table[:, 7:], shown, at, goal, seconds, cpu)

    def _coverage(self, row: np.ndarray, goal: np.ndarray) -> float:
        """Coverage with the object at (7,) q_WO wxyz, p_WO [m]; NaN where the task has no pose for a goal."""
        X_WG = self.env.task.with_goal(goal).goal_pose(float(row[6]))
        if X_WG is None or not np.isfinite(row).all():
            return math.nan
        X_WO = Pose(*(torch.from_numpy(part.copy()) for part in (row[:4], row[4:7])))
        return coverage(self._mesh, pose_to_matrix(X_WO).numpy(), pose_to_matrix(X_WG).numpy())


def run_episodes(
    runner: EpisodeRunner,
    request: EvaluateRequest,
    seeds: Sequence[int],
    store: EpisodeStore,
    executor: Executor,
    *,
    on_result: Callable[[int, EpisodeRecord], None] = lambda seed, record: None,
) -> list[EpisodeRecord]:
    """Run those episodes that the store does not have, and keep each when it is done.

    Args:
        runner: For this process; workers make their own.
        request: What is asked for.
        seeds: Of the episodes.
        store: Where episodes are kept.
        executor: The processes, on which results do not depend.
        on_result: Called with each seed and its episode: those of the store, then each when it is done.

    Returns:
        The episodes in the order of the seeds.

    Raises:
        PinwmError: A policy or scene cannot be used, or an episode of the store is of other settings.
        ParameterError: A worker was killed, or the policy has changed.
    """
    identity = runner.contestant.identity
    _runners[identity, request] = runner
    try:
        return executor.map(partial(_run, request, identity), seeds, store=store, on_result=on_result)
    finally:
        del _runners[identity, request]


def _run(request: EvaluateRequest, identity: str, seed: int) -> EpisodeRecord:
    """Return an episode, in an environment that is made for the first one and kept."""
    if (identity, request) not in _runners:
        contestant = read_contestant(request)
        if contestant.identity != identity:
            raise ParameterError(f"{request.policy}: the policy changed while it was evaluated; start a new evaluation")
        _runners[identity, request] = EpisodeRunner(contestant, request)
    return _runners[identity, request].run(seed)
