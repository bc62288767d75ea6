# SPDX-License-Identifier: MIT
import gc
import io
import math
import os
import sys
from collections.abc import Callable, Iterator
from contextlib import redirect_stderr, redirect_stdout
from functools import cache
from pathlib import Path
from typing import Any

import pytest

from pinwm_drake.cli import console, main

# Before torch is imported, here and in the processes that tests start: of two workers with two threads of OpenMP each,
# all spin while they wait for each other, and small networks took up to twenty times as long.
os.environ.setdefault("OMP_NUM_THREADS", "1")

ROOT = Path(__file__).resolve().parent.parent


def pytest_collection_finish() -> None:
    """Keep what libraries and the collected tests made, a million objects, out of all later garbage collections."""
    gc.freeze()


@pytest.fixture(scope="session")
def pinwm() -> Callable[..., tuple[int, str, str]]:
    """Runs `pinwm` in this process: arguments in; exit code, output and error output back."""

    def run(*arguments: str) -> tuple[int, str, str]:
        code, output, errors = 0, io.StringIO(), io.StringIO()
        with pytest.MonkeyPatch.context() as patch, redirect_stdout(output), redirect_stderr(errors):
            patch.setattr(sys, "argv", ["pinwm", *arguments])
            patch.setattr(console, "_FIRST", math.inf)  # no line on progress, however slow the machine is
            try:
                main()
            except SystemExit as end:
                code = end.code or 0
        return code, output.getvalue(), errors.getvalue()

    return run


@pytest.fixture(scope="session")
def read_operators_once() -> Iterator[None]:
    """Makes torch read the operators of ONNX once, and not for each export, which takes half a second.

    Trainings try out the export of networks of one shape once.
    """
    from torch.onnx._internal.exporter._registration import ONNXRegistry

    from pinwm_drake.experiments import training

    check, known = training.check_exportable, set()

    def once(spec: Any) -> None:
        task = type(spec.task), spec.task.goal_size
        shape = spec.image_shape, spec.pusher_size, spec.head, spec.window, spec.width, *task
        if shape not in known:
            check(spec)
            known.add(shape)

    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(ONNXRegistry, "from_torchlib", staticmethod(cache(ONNXRegistry.from_torchlib)))
        patch.setattr(training, "check_exportable", once)
        yield


@pytest.fixture(scope="session", autouse=True)
def shipped_codecs() -> Iterator[tuple[str, ...]]:
    """Codecs of films as the package has them; tests write the last one, which takes a fortieth of the time."""
    from pinwm_drake.report import video

    shipped = video._CODECS
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(video, "_CODECS", shipped[-1:])
        yield shipped


@pytest.fixture(scope="session")
def shared() -> Path:
    """The project's shared folder, beside the checkout; tests of released data skip where it is not."""
    folder = Path(os.environ.get("PINWM_SHARED", ROOT.parent / "shared"))
    if not (folder / "data").is_dir():
        pytest.skip(f"no {folder}/data on this machine")
    return folder
