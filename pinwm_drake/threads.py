# SPDX-License-Identifier: MIT
"""Threads for kernels that release Python's lock."""

import functools
import os
import sys
from collections.abc import Callable, Iterator
from concurrent.futures import ThreadPoolExecutor
from contextlib import contextmanager
from itertools import pairwise

import numpy as np

# More parts than threads, so that a thread which is done early takes over.
_PARTS_PER_THREAD = 8
# An environment variable: threads at the most, of a process that is one of several.
LIMIT = "PINWM_THREADS"


def share(kernel: Callable[..., None], arguments: tuple, number: int, num_threads: int) -> None:
    """Run kernel(*arguments, first, last) on parts of range(number), shared among threads.

    Args:
        kernel: releases Python's lock, and writes nothing that another part reads or writes.
        arguments: arguments of the kernel before the range.
        number: number of items, such as worlds or views.
        num_threads: threads at the most.
    """
    threads = min(num_threads, number)
    if threads <= 1:
        kernel(*arguments, 0, number)
        return
    bounds = np.linspace(0, number, min(_PARTS_PER_THREAD * threads, number) + 1).astype(int).tolist()
    parts = [pool(threads).submit(kernel, *arguments, first, last) for first, last in pairwise(bounds)]
    for part in parts:
        part.result()


@contextmanager
def one_torch_thread() -> Iterator[None]:
    """Context that leaves the cores to the kernels: torch's work beside them is small, and its idle threads spin.

    On two busy cores a fit of surfels took 70 ms an iteration with two threads of torch, and 31 ms with one.
    """
    import torch

    before = torch.get_num_threads()
    torch.set_num_threads(1)
    try:
        yield
    finally:
        torch.set_num_threads(before)


@functools.cache
def pool(number: int) -> ThreadPoolExecutor:
    """Threads that live as long as the process: starting them would take longer than a small kernel."""
    return ThreadPoolExecutor(number, thread_name_prefix="pinwm")


@functools.cache
def available() -> int:
    """Cores that this process may use, `LIMIT` at the most, as it was when first asked."""
    cores = len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1
    return min(cores, int(os.environ.get(LIMIT, cores)))


def _after_fork() -> None:
    """Let a forked child work without its parent's threads, which a fork does not copy.

    It starts its own for kernels. torch gets one: libgomp would wait for those of the parent, for ever.
    """
    pool.cache_clear()
    if torch := sys.modules.get("torch"):
        torch.set_num_threads(1)


if hasattr(os, "register_at_fork"):
    os.register_at_fork(after_in_child=_after_fork)
