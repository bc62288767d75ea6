# SPDX-License-Identifier: MIT
"""Compilation of the physics' kernels in a second process, while the first one fits surfels.

numba compiles on one core and keeps the result on disk beside the sources, where the first process then finds it.
"""

import logging
import multiprocessing
import signal
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from multiprocessing.connection import Connection
from pathlib import Path

import torch

from pinwm_drake.capture.episodes import read_episode
from pinwm_drake.capture.scene import load_capture
from pinwm_drake.demo.stages import Cost, cpu_seconds
from pinwm_drake.errors import PinwmError
from pinwm_drake.identification.forward import Forward
from pinwm_drake.identification.identify import capture_scene
from pinwm_drake.identification.options import IdentifyOptions
from pinwm_drake.identification.time_step import time_step_of
from pinwm_drake.identification.unknowns import Coordinates


@contextmanager
def compiling(capture: Path, options: IdentifyOptions) -> Iterator[Callable[[], Cost | None]]:
    """Compiles what the identification of a capture needs in a second process, to the end of a `with` block at most.

    Yields:
        Function that waits for the process and returns what it took; None where it failed, and the identification
        compiles for itself.
    """
    # Spawned: a fork would copy the locks of threads that it does not copy.
    context = multiprocessing.get_context("spawn")
    receiver, sender = context.Pipe(duplex=False)
    process = context.Process(target=_compile, args=(capture, options, sender), daemon=True)
    process.start()
    # With no other sender left, a process that dies is noticed.
    sender.close()

    def wait() -> Cost | None:
        try:
            return Cost("compile the physics", *receiver.recv())
        except EOFError:
            return None

    try:
        yield wait
    finally:
        process.terminate()
        process.join()
        receiver.close()


def _compile(folder: Path, options: IdentifyOptions, sender: Connection) -> None:
    """Call every kernel that an identification needs, forward and backward; send wall time and CPU time [s]."""
    logging.getLogger("pinwm_drake").setLevel(logging.ERROR)  # the first process says that kernels are compiled
    signal.signal(signal.SIGINT, signal.SIG_IGN)  # Ctrl-C is for the first process, which ends this one
    begun = time.perf_counter()
    torch.set_num_threads(1)
    # The first process will meet an error too, and say it.
    with suppress(PinwmError):
        capture = load_capture(folder)
        episode, X_WO = read_episode(capture, capture.episode_names[0]), capture.object.X_WO
        step = options.time_step or time_step_of([episode])
        mass, scene = capture.object.mass or 1.0, capture_scene(capture, step, facets=options.facets)
        coordinates = Coordinates(options.names, {"mass": mass, **options.held})
        guess = coordinates.draw(1, torch.Generator().manual_seed(options.seed)).requires_grad_()
        poses, _ = Forward(scene, episode, X_WO, mass, 1, chosen=torch.tensor([0, 1])).poses(coordinates.values(guess))
        poses.p.sum().backward()
        sender.send((time.perf_counter() - begun, cpu_seconds()))
