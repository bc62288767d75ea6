"""Runs the episodes of an evaluation, in this process or shared among several."""

import multiprocessing
import os
import signal
import threading
import time
from collections.abc import Iterator, Sequence
from concurrent.futures import ProcessPoolExecutor, as_completed
from concurrent.futures.process import BrokenProcessPool
from multiprocessing.connection import Connection
from typing import Any

import numpy as np
import torch

from pinwm_drake.errors import ParameterError, PinwmError
from pinwm_drake.experiments.evaluation.contestant import Contestant, make_environment, read_contestant
from pinwm_drake.experiments.evaluation.request import EvaluateRequest
from pinwm_drake.learning.evaluation import run_episode
from pinwm_drake.report.evaluation.episode import EpisodeRecord
from pinwm_drake.report.evaluation.report import strip_steps

_runners: dict[str, "EpisodeRunner"] = {}  # those of this worker, by the contestant's identity


class EpisodeRunner:
    """An environment with a policy in it.

    Attributes:
        contestant: Policy or controller that acts.
        env: The environment.
    """

    def __init__(self, contestant: Contestant, request: EvaluateRequest) -> None:
        """Makes the environment.

        Raises:
            PinwmError: The scene cannot be used, or is not one that the policy is made for.
        """
        self.contestant, self.env = contestant, make_environment(contestant, request)
        self._policy = contestant.make(self.env)

    def run(self, seed: int) -> EpisodeRecord:
        """Runs an episode, all of which follows from its seed."""
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
        at = np.array(strip_steps(len(rows) - 1) if views else [], int)
        shown = np.array([views[step] for step in at]) if views else np.zeros((0, 0, 0, 3), np.uint8)
        return EpisodeRecord(result, table[:, :4], table[:, 4:7], table[:, 7:], shown, at, seconds, cpu)


def run_episodes(
    runner: EpisodeRunner, request: EvaluateRequest, seeds: Sequence[int], workers: int
) -> Iterator[EpisodeRecord]:
    """Runs episodes, and yields each when it is done. Results do not depend on the number of workers.

    Args:
        runner: Runner for this process; workers make their own.
        request: Request of the evaluation.
        seeds: Seeds of the episodes.
        workers: Number of processes, 1 or more, with one thread of torch each.

    Raises:
        PinwmError: A policy or scene cannot be used.
        ParameterError: A worker was killed, or the policy has changed.
    """
    if workers == 1 or len(seeds) <= 1:
        threads = torch.get_num_threads()
        torch.set_num_threads(1)
        try:
            for seed in seeds:
                yield runner.run(seed)
        finally:
            torch.set_num_threads(threads)
        return
    # Spawned: a fork would copy the locks of threads that it does not copy.
    context = multiprocessing.get_context("spawn")
    ends, lasts = context.Pipe(duplex=False)
    identity = runner.contestant.identity
    pool, whole = ProcessPoolExecutor(min(workers, len(seeds)), context, _begin, (ends,)), False
    try:
        jobs = [pool.submit(_run, request, identity, seed) for seed in seeds]
        for job in as_completed(jobs):
            yield job.result()
        whole = True
    except BrokenProcessPool as error:
        raise ParameterError(
            f"--workers: got {workers}, of which one ended by itself, perhaps for want of memory; the episodes that "
            "are done are kept: go on with --resume, and fewer of them"
        ) from error
    finally:
        pool.shutdown(wait=whole, cancel_futures=True)
        lasts.close()  # which ends workers that are in an episode
        ends.close()


def _begin(ends: Connection) -> None:
    """Prepares a worker, which ends with the process that started it, whatever ends that."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    torch.set_num_threads(1)
    threading.Thread(target=_end_with, args=(ends,), daemon=True).start()


def _end_with(ends: Connection) -> None:
    try:
        ends.recv_bytes()
    except (EOFError, OSError):
        os._exit(1)


def _run(request: EvaluateRequest, identity: str, seed: int) -> EpisodeRecord:
    """Runs an episode in a worker, whose environment is made for the first one, and kept."""
    try:
        if identity not in _runners:
            contestant = read_contestant(request)
            if contestant.identity != identity:
                raise ParameterError(f"{request.policy}: got another policy than a moment ago; allowed: one that stays")
            _runners[identity] = EpisodeRunner(contestant, request)
        return _runners[identity].run(seed)
    except PinwmError as error:
        # Not every error of the family can be sent from process to process.
        raise ParameterError(str(error)) from None
