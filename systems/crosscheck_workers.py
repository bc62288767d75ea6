"""Runs pushes through engines, in this process or shared among several."""

import multiprocessing
from collections.abc import Callable, Sequence
from concurrent.futures import ProcessPoolExecutor, as_completed

import torch

from pinwm_drake.errors import ParameterError, PinwmError
from pinwm_drake.systems.crosscheck_motion import Motion, PushRig
from pinwm_drake.systems.crosscheck_pushes import Trial
from pinwm_drake.systems.setup import Setup

# What an engine is called, and the setup of its station.
Cases = dict[str, Setup]

_rigs: dict[str, PushRig] = {}  # of a worker


def run_trials(
    cases: Cases, trials: Sequence[Trial], *, processes: int = 1, report: Callable[[], None] = lambda: None
) -> list[dict[str, Motion]]:
    """Every push through every engine.

    Args:
        cases: The engines.
        trials: The pushes.
        processes: That share the pushes, 1 or more; with one thread each. Results do not depend on it.
        report: Called after each push.

    Returns:
        For each push the motion in each engine, in the order of the trials.

    Raises:
        PinwmError: A station cannot be made.
    """
    if processes == 1 or len(trials) == 1:
        rigs = _make(cases)
        found = []
        for trial in trials:
            found.append({name: rig.run(trial) for name, rig in rigs.items()})
            report()
        return found
    # Spawned: a fork would copy the locks of threads that it does not copy.
    context = multiprocessing.get_context("spawn")
    with ProcessPoolExecutor(min(processes, len(trials)), context, _begin) as pool:
        jobs = [pool.submit(_run, cases, trial) for trial in trials]
        try:
            for job in as_completed(jobs):
                job.result()
                report()
        except BaseException:
            pool.shutdown(wait=False, cancel_futures=True)
            raise
        return [job.result() for job in jobs]


def _make(cases: Cases) -> dict[str, PushRig]:
    return {name: PushRig(setup, name) for name, setup in cases.items()}


def _begin() -> None:
    torch.set_num_threads(1)


def _run(cases: Cases, trial: Trial) -> dict[str, Motion]:
    """What a worker does; its stations are made for the first push, and kept."""
    try:
        if not _rigs:
            _rigs.update(_make(cases))
        return {name: rig.run(trial) for name, rig in _rigs.items()}
    except PinwmError as error:
        # Not every error of the family can be sent from process to process.
        raise ParameterError(str(error)) from None
