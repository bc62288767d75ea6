# SPDX-License-Identifier: MIT
"""Fair timings: fixed threads, interleaved rounds, medians with quartiles."""

import multiprocessing
import os
import time
from collections.abc import Callable, Hashable, Mapping
from concurrent.futures import ProcessPoolExecutor
from dataclasses import dataclass
from pathlib import Path
from typing import Any, TypeVar

import numpy as np


def limit_threads(threads: int, cpus: int | None = None) -> None:
    """Fix the width of every thread pool of this process; call it before importing numba or torch.

    Args:
        threads: Largest number of threads of OpenMP, MKL, OpenBLAS and numba.
        cpus: Number of CPUs to which the process is bound; `threads` when None.
    """
    for name in ("OMP_NUM_THREADS", "MKL_NUM_THREADS", "OPENBLAS_NUM_THREADS", "NUMBA_NUM_THREADS"):
        os.environ[name] = str(threads)
    if hasattr(os, "sched_setaffinity"):  # Linux only; elsewhere the operating system places the threads
        allowed = sorted(os.sched_getaffinity(0))
        # The last CPUs: the first one tends to serve the interrupts.
        os.sched_setaffinity(0, allowed[-min(cpus or threads, len(allowed)) :])


class CompetingLoad:
    """Share of the machine's CPUs that other processes take within a `with` block.

    A timing taken beside other work is not wrong by itself (the rounds are interleaved, so that all the cases
    suffer alike), but a reader should know of it. Linux only; NaN elsewhere.

    Attributes:
        percent: Share of all CPUs together, per cent; set when the block ends.
    """

    percent = float("nan")

    def __enter__(self) -> "CompetingLoad":
        self._before = self._seconds()
        return self

    def __exit__(self, *_: object) -> None:
        everyone, total, own = (after - before for after, before in zip(self._seconds(), self._before, strict=True))
        self.percent = 100.0 * max(0.0, everyone - own) / total if total > 0.0 else float("nan")

    @staticmethod
    def _seconds() -> tuple[float, float, float]:
        """CPU time in seconds: taken by everyone, there in all, and taken by this process and its children."""
        stat = Path("/proc/stat")
        if not stat.exists():
            return 0.0, 0.0, 0.0
        ticks = [int(word) for word in stat.read_text().splitlines()[0].split()[1:9]]
        idle = ticks[3] + ticks[4]  # idle, and waiting for input and output
        second = os.sysconf("SC_CLK_TCK")
        own = sum(os.times()[:4])  # with the processes that it started, once they have ended
        return (sum(ticks) - idle) / second, sum(ticks) / second, own


def alone(function: Callable[..., Any], *arguments: object) -> Any:
    """Return the result of a call in a process of its own, whose threads are not fixed yet."""
    with ProcessPoolExecutor(1, multiprocessing.get_context("spawn")) as pool:
        return pool.submit(function, *arguments).result()


_Name = TypeVar("_Name", bound=Hashable)


@dataclass(frozen=True)
class Case:
    """Case to time: a call, its preparation, and its units.

    Attributes:
        run: The timed call.
        prepare: Called, untimed, before each `run`.
        units: Number of units in one `run`, e.g. the number of steps that it takes.
    """

    run: Callable[[], object]
    prepare: Callable[[], object] = lambda: None
    units: int = 1


@dataclass(frozen=True)
class Samples:
    """Timings of one case.

    Attributes:
        seconds: (rounds,) time of each round divided by the case's units, in seconds.
    """

    seconds: np.ndarray

    @property
    def median(self) -> float:
        """Median, in seconds a unit."""
        return float(np.median(self.seconds))

    def summary(self, scale: float = 1e6) -> dict[str, float]:
        """Median and quartiles times `scale` (1e6: microseconds a unit)."""
        low, middle, high = np.percentile(self.seconds, [25, 50, 75]) * scale
        return {"median": round(float(middle), 3), "q1": round(float(low), 3), "q3": round(float(high), 3)}

    def over(self, other: "Samples") -> dict[str, float]:
        """Median and quartiles of the round-by-round ratio to `other`."""
        return Samples(self.seconds / other.seconds).summary(scale=1.0)


def interleave(
    cases: Mapping[_Name, Case],
    rounds: int,
    warmup: int = 2,
    clock: Callable[[], float] = time.perf_counter,
) -> dict[_Name, Samples]:
    """Time all cases in interleaved rounds: A B C A B C and so on.

    Whatever slows the machine for a while then slows all of them alike, and the ratio of two cases is taken
    within a round.

    Args:
        cases: Cases to time.
        rounds: Number of timed rounds.
        warmup: Number of rounds that are run first and not counted (compilation, caches, allocations).
        clock: Time in seconds. For cases of one thread `time.process_time` is the better one: it stops while
            other processes have the core, and is the same as the wall's on a machine that does nothing else.
    """
    seconds: dict[_Name, list[float]] = {name: [] for name in cases}
    for round_ in range(warmup + rounds):
        for name, case in cases.items():
            case.prepare()
            start = clock()
            case.run()
            elapsed = clock() - start
            if round_ >= warmup:
                seconds[name].append(elapsed / case.units)
    return {name: Samples(np.array(values)) for name, values in seconds.items()}
