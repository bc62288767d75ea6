# SPDX-License-Identifier: MIT
"""Examination of an installation and its machine: what is there, what is broken, what is slow, and what to do."""

import importlib
import math
import os
import platform
import shutil
import socket
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable, Iterator
from contextlib import suppress
from dataclasses import dataclass
from importlib import metadata
from pathlib import Path
from typing import Literal

from packaging.requirements import InvalidRequirement, Requirement

import pinwm_drake
from pinwm_drake.memory import CGROUPS, memory
from pinwm_drake.threads import LIMIT, available

Status = Literal["ok", "slow", "broken"]
_SHOWN = ("drake", "torch", "numba", "numpy", "opencv-python-headless", "onnxruntime", "gymnasium", "stable-baselines3")
_KERNELS = (  # modules with entry points of kernels
    "pinwm_drake.geometry.entry",
    "pinwm_drake.physics.kernels.recorded",
    "pinwm_drake.physics.kernels.rollout",
    "pinwm_drake.rendering.kernels.backward",
    "pinwm_drake.rendering.kernels.forward",
    "pinwm_drake.rendering.kernels.ssim",
    "pinwm_drake.rendering.kernels.triangles",
)
_GIB = 1 << 30
_LEAST_MEMORY, _LEAST_DISK = 2 * _GIB, _GIB  # bytes
_BUSY = 1.5  # load for each core above which other work slows this down
_FIRST_PORT, _PORTS = 7000, 100  # of Meshcat
_PATIENCE = 60.0  # s, for the first picture


@dataclass(frozen=True)
class Finding:
    """Result of one check.

    Attributes:
        name: Name of what was looked at.
        status: "ok", "slow" for what works and costs time, or "broken" for what is needed and does not work.
        found: What is there, in words.
        advice: What to do, in words; empty where nothing is.
    """

    name: str
    status: Status
    found: str
    advice: str = ""


def examine(out: Path = Path()) -> Iterator[Finding]:
    """Make all checks, one after the other; each ends within a minute, and none compiles a kernel.

    Args:
        out: Folder in which results would be written.
    """
    checks: tuple[tuple[str, Callable[[], Finding]], ...] = (
        ("versions", check_versions),
        ("torch", check_torch),
        ("cores", check_cores),
        ("threads", check_threads),
        ("memory", check_memory),
        ("kernels", check_kernels),
        ("rendering", check_rendering),
        ("disk", lambda: check_disk(out)),
        ("Meshcat", check_meshcat),
    )
    for name, check in checks:
        try:
            yield check()
        except Exception as error:  # a library that fails when it is imported, in whatever way
            yield Finding(
                name, "broken", f"{type(error).__name__}: {error}".splitlines()[0], "install the package anew"
            )


def check_versions() -> Finding:
    """Check Python and the libraries that the package requires, each with its version."""
    shown = [f"pinwm_drake {pinwm_drake.__version__}", f"python {platform.python_version()}"]
    for name in _SHOWN:
        with suppress(metadata.PackageNotFoundError):
            shown.append(f"{name} {metadata.version(name)}")
    wrong = list(_unmet())
    if not wrong:
        return Finding("versions", "ok", ", ".join(shown))
    return Finding("versions", "broken", ", ".join(shown), f"pip install {' '.join(wrong)}")


def _unmet() -> Iterator[str]:
    """Requirements of the package that are not met, quoted for pip; none where it is not installed."""
    with suppress(metadata.PackageNotFoundError):
        for text in metadata.requires("pinwm_drake") or ():
            try:
                wanted = Requirement(text)
            except InvalidRequirement:
                continue
            if wanted.marker is not None and not wanted.marker.evaluate({"extra": ""}):
                continue
            try:
                met = wanted.specifier.contains(metadata.version(wanted.name), prereleases=True)
            except metadata.PackageNotFoundError:
                met = False
            if not met:
                yield f"'{wanted.name}{wanted.specifier}'"


def check_torch() -> Finding:
    """Check the build of torch: for the CPU, or for CUDA and whether a GPU is there."""
    import torch

    built = torch.version.cuda
    if not built:
        return Finding("torch", "ok", f"{torch.__version__}, build for the CPU")
    if torch.cuda.is_available():
        return Finding("torch", "ok", f"{torch.__version__}, CUDA {built}, {torch.cuda.get_device_name()}")
    return Finding(
        "torch",
        "ok",
        f"{torch.__version__}, CUDA {built}, no GPU",
        "the build for the CPU is smaller: pip install torch --index-url https://download.pytorch.org/whl/cpu",
    )


def check_cores() -> Finding:
    """Check the cores that this process may use, and whether other processes use them."""
    total, usable, quota = os.cpu_count() or 1, _affinity(), cpu_quota()
    found = f"{usable} of {total}"
    found += f", of which the container allows {quota:g}" if quota is not None else ""
    load = os.getloadavg()[0] if hasattr(os, "getloadavg") else 0.0
    cores = min(usable, quota or math.inf)
    found += f"; load {load:.1f}"
    if quota is not None and quota < available():
        return Finding("cores", "slow", found, f"set {LIMIT}={max(1, math.floor(quota))}: more threads only wait")
    if load > _BUSY * cores:
        return Finding("cores", "slow", found, "other processes use the cores: wait for them, or end them")
    if cores < 2:
        return Finding("cores", "slow", found, "two cores or more nearly halve a training")
    return Finding("cores", "ok", found)


def _affinity() -> int:
    return len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1


def cpu_quota(root: Path = CGROUPS) -> float | None:
    """Return the number of cores that the container's control group allows; None where it sets no limit."""
    with suppress(OSError, ValueError):  # version 2
        quota, period = (root / "cpu.max").read_text().split()
        return None if quota == "max" else float(quota) / float(period)
    with suppress(OSError, ValueError):  # version 1
        amount = float((root / "cpu/cpu.cfs_quota_us").read_text())
        return None if amount <= 0 else amount / float((root / "cpu/cpu.cfs_period_us").read_text())
    return None


def check_threads() -> Finding:
    """Check the settings of threads: the package's own, and OpenMP's, which torch takes."""
    set_to = {name: os.environ[name] for name in (LIMIT, "OMP_NUM_THREADS") if name in os.environ}
    found = f"{available()} for kernels; " + (", ".join(f"{k}={v}" for k, v in set_to.items()) or "no limit is set")
    number = set_to.get("OMP_NUM_THREADS", "1")
    if number.isdigit() and int(number) > _affinity():
        return Finding("threads", "slow", found, f"set OMP_NUM_THREADS={_affinity()}: more threads only wait")
    if available() < _affinity():
        return Finding("threads", "slow", found, f"unset {LIMIT} to use all {_affinity()} cores")
    return Finding("threads", "ok", found)


def check_memory() -> Finding:
    """Check the memory that is free, by the machine and by the container's control group."""
    total, free = memory()
    found = f"{free / _GIB:.1f} of {total / _GIB:.1f} GiB free" if total else "not known on this system"
    if total and free < _LEAST_MEMORY:
        return Finding(
            "memory", "slow", found, "end other processes; fewer --worlds, --workers or --processes need less"
        )
    return Finding("memory", "ok", found)


def check_kernels() -> Finding:
    """Check numba's cache of compiled kernels: where it is, whether it is warm, and whether it can be written."""
    from pinwm_drake.kernel_cache import COMPILING, kernel_cache

    if os.environ.get("NUMBA_DISABLE_JIT", "0") not in ("", "0"):
        return Finding("kernels", "slow", "NUMBA_DISABLE_JIT is set: kernels run as Python", "unset NUMBA_DISABLE_JIT")
    try:
        for name in _KERNELS:
            importlib.import_module(name)
    except RuntimeError as error:  # numba finds no folder for its cache
        return Finding("kernels", "broken", str(error), "set NUMBA_CACHE_DIR to a folder that can be written to")
    cache = kernel_cache()
    common = os.path.commonpath(cache.folders) if cache.folders else "nowhere"
    found = f"{cache.compiled} of {cache.entries} compiled, cached below {common}"
    if not cache.writable and cache.compiled < cache.entries:
        found += ", which cannot be written to"
        return Finding("kernels", "slow", found, "set NUMBA_CACHE_DIR to a folder that can be written to")
    if cache.compiled * 2 < cache.entries:
        return Finding("kernels", "slow", found, f"the first run is slow, once: {COMPILING}")
    return Finding("kernels", "ok", found)


def check_rendering() -> Finding:
    """Check that Drake renders a picture, in a process of its own: a missing driver can end a process."""
    code = f"from {__name__} import draw_ball; draw_ball()"
    begun = time.monotonic()
    environment = {**os.environ, "PYTHONPATH": os.pathsep.join(filter(None, sys.path))}
    advice = "install libegl1 and libgl1 (Mesa's do); without them commands with Drake's cameras fail"
    try:
        run = subprocess.run(
            [sys.executable, "-c", code],
            capture_output=True,
            text=True,
            timeout=_PATIENCE,
            env=environment,
            check=False,
        )
    except subprocess.TimeoutExpired:
        return Finding("rendering", "broken", f"no picture of Drake's VTK within {_PATIENCE:g} s", advice)
    if run.returncode != 0:
        lines = (run.stderr.strip() or f"exit code {run.returncode}").splitlines()
        return Finding("rendering", "broken", f"no picture of Drake's VTK: {lines[-1]}", advice)
    seconds, first = float(run.stdout.split()[-1]), time.monotonic() - begun
    return Finding(
        "rendering", "ok", f"Drake's VTK draws, {1e3 * seconds:.0f} ms a small picture; {first:.1f} s to start"
    )


def draw_ball() -> None:
    """Draw a red ball by Drake's VTK engine, and print the time [s] of a second picture.

    Raises:
        RuntimeError: The picture does not show it.
    """
    from pydrake.geometry import (
        ClippingRange,
        ColorRenderCamera,
        GeometryInstance,
        MakePhongIllustrationProperties,
        MakeRenderEngineVtk,
        PerceptionProperties,
        RenderCameraCore,
        RenderEngineVtkParams,
        RenderLabel,
        SceneGraph,
        Sphere,
    )
    from pydrake.math import RigidTransform
    from pydrake.systems.sensors import CameraInfo

    scene_graph = SceneGraph()
    scene_graph.AddRenderer("vtk", MakeRenderEngineVtk(RenderEngineVtkParams()))
    source = scene_graph.RegisterSource("ball")
    ball = GeometryInstance(RigidTransform([0.0, 0.0, 1.0]), Sphere(0.3), "ball")
    properties = PerceptionProperties(MakePhongIllustrationProperties([1.0, 0.0, 0.0, 1.0]))
    properties.AddProperty("label", "id", RenderLabel(1))
    ball.set_perception_properties(properties)
    scene_graph.RegisterAnchoredGeometry(source, ball)
    context = scene_graph.CreateDefaultContext()
    core = RenderCameraCore("vtk", CameraInfo(64, 64, 1.0), ClippingRange(0.1, 10.0), RigidTransform())
    query = scene_graph.get_query_output_port().Eval(context)
    for _ in range(2):
        begun = time.perf_counter()
        image = query.RenderColorImage(ColorRenderCamera(core), scene_graph.world_frame_id(), RigidTransform())
    red, green, blue, _ = image.data[32, 32]
    if not red > 1.5 * max(green, blue):
        raise RuntimeError(f"the ball is not red, but {red}, {green}, {blue}")
    sys.stdout.write(f"{time.perf_counter() - begun}\n")


def check_disk(out: Path) -> Finding:
    """Check the space for results and for temporary files."""
    places = {"results": out.resolve(), "temporary files": Path(tempfile.gettempdir())}
    free = {name: shutil.disk_usage(_there(path)).free for name, path in places.items()}
    found = ", ".join(f"{amount / _GIB:.0f} GiB free for {name}" for name, amount in free.items())
    short = [str(places[name]) for name, amount in free.items() if amount < _LEAST_DISK]
    if not os.access(_there(places["results"]), os.W_OK):
        return Finding("disk", "broken", f"{places['results']} cannot be written to", "change to another folder")
    if short:
        return Finding("disk", "slow", found, f"free some space at {' and '.join(short)}")
    return Finding("disk", "ok", found)


def _there(path: Path) -> Path:
    while not path.exists():
        path = path.parent
    return path


def check_meshcat() -> Finding:
    """Check that Meshcat can listen on this machine alone, and on which port."""
    for port in range(_FIRST_PORT, _FIRST_PORT + _PORTS):
        with socket.socket() as one:
            try:
                one.bind(("127.0.0.1", port))
            except OSError:
                continue
            return Finding("Meshcat", "ok", f"http://localhost:{port} is free; other machines cannot open it")
    found = f"no free port from {_FIRST_PORT} to {_FIRST_PORT + _PORTS - 1} on localhost"
    return Finding("Meshcat", "slow", found, "end other viewers, or name a free --port")
