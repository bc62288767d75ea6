# SPDX-License-Identifier: MIT
"""Agreement of motion, images, actions and identified parameters over numbers of threads and makes of CPU.

Each variant runs in a process of its own. Another make of CPU is one that has no AVX and no FMA, as libraries are told
by their switches: numba compiles for x86-64-v2; torch, OpenBLAS, MKL, numpy and glibc take their paths for such
machines. ONNX Runtime has no switch, so that its actions are those of the machine at hand in all variants. `number` and
`seed` change nothing.
"""

import contextlib
import json
import os
import subprocess
import sys
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np

ROOT = Path(__file__).resolve().parents[2]
_THREADS = ("OMP_NUM_THREADS", "NUMBA_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS")
OLD_LIBRARIES = {
    "ATEN_CPU_CAPABILITY": "default",
    "OPENBLAS_CORETYPE": "Nehalem",
    "MKL_ENABLE_INSTRUCTIONS": "SSE4_2",
    "NPY_DISABLE_CPU_FEATURES": "X86_V3 X86_V4 AVX512_ICL AVX512_SPR",
    "GLIBC_TUNABLES": "glibc.cpu.hwcaps=-AVX2,-FMA,-AVX512F,-AVX512VL",
}
OLD_KERNELS = {"NUMBA_CPU_NAME": "x86-64-v2", "NUMBA_CPU_FEATURES": "-avx,-avx2,-fma"}
VARIANTS: dict[str, tuple[int, dict[str, str]]] = {
    "1 thread": (1, {}),
    "2 threads": (2, {}),
    "CPU without AVX and FMA, 1 thread": (1, OLD_LIBRARIES | OLD_KERNELS),
}
TOLERANCES = {
    "motion": ("m, rad", 1e-9),  # double precision, 200 steps with contact
    "image": ("of white", 1e-5),  # single precision, some dozens of blended surfels
    "action, onnxruntime": ("m", 1e-6),  # single precision
    "action, torch": ("of the longest", 1e-4),  # single precision, after a softmax over levels
    "theta": ("of half the interval", 0.2),  # set after 0.07 was measured; its cause is not known
}
"""Largest difference from the first variant that is allowed, by quantity, with its unit."""


def motion(threads: int, inputs: Path) -> np.ndarray:
    """Poses of a push of the T-block in two worlds, by the compiled stepper."""
    from pinwm_drake.physics.stepper import Stepper
    from tests.physics.scenes import nominal, push_model, push_start, straight_push

    model = push_model()
    parameters = nominal(model, friction_floor=0.3, num_worlds=2)
    stepper = Stepper(model, num_threads=threads)
    record = stepper.rollout(parameters, push_start(model, 2), straight_push(200, 2), record_every=50)
    return np.concatenate([record.p_WB.numpy().ravel(), record.q_WB.numpy().ravel()])


def image(threads: int, inputs: Path) -> np.ndarray:
    """Image of the T-block's surfels."""
    from pinwm_drake.rendering.render import render
    from pinwm_drake.twin.read import load_twin
    from tests.rendering.boxes import box, views_around

    view = views_around(box())[0]
    return render(load_twin("t_block").surfels, view.camera, view.X_CO, full=False, num_threads=threads).color.numpy()


def onnx_action(threads: int, inputs: Path) -> np.ndarray:
    """Answers of the bundle that ships to its golden samples."""
    from pinwm_drake.learning.bundle import GOLDEN_FILE, read_bundle
    from pinwm_drake.learning.golden import Golden
    from pinwm_drake.models import policy_path

    bundle, path = read_bundle("push_t"), policy_path("push_t") / GOLDEN_FILE
    golden = Golden.from_bytes(path.read_bytes(), path, bundle.contract)
    return np.array(
        [bundle.network.run(image, p_WP)[0] for image, p_WP in zip(golden.images, golden.p_WP, strict=True)]
    )


def torch_action(threads: int, inputs: Path) -> np.ndarray:
    """Answers of an untrained policy in torch."""
    import torch

    from tests.learning.bundles import image_spec, pictures, untrained_policy

    torch.set_num_threads(threads)
    spec = image_spec(64)
    images, p_WP = pictures(spec, 20)
    found: np.ndarray = untrained_policy(spec).predict({"image": images, "pusher": p_WP})[0]
    return found


def theta(threads: int, inputs: Path) -> np.ndarray:
    """Values that `pinwm identify` finds from a push, and half the widths of their intervals; 1 where there is none."""
    from pinwm_drake.cli import main as pinwm
    from pinwm_drake.twin.read import load_twin
    from tests.identification.samples import write_appearance

    out = inputs / f"twin{os.getpid()}"
    write_appearance(out)
    small = ("--starts", "1", "--support", "patch", "--free", "friction_floor", "--time-step", "0.005")
    sys.argv = ["pinwm", "identify", str(inputs / "push"), str(out), *small, "--threads", str(threads)]
    with contextlib.suppress(SystemExit):
        pinwm()
    found = load_twin(out).theta.values()
    widths = [1.0 if one.interval is None else (one.interval[1] - one.interval[0]) / 2 for one in found]
    return np.array([[one.value, width] for one, width in zip(found, widths, strict=True)])


QUANTITIES: dict[str, Callable[[int, Path], np.ndarray]] = {
    "motion": motion,
    "image": image,
    "action, onnxruntime": onnx_action,
    "action, torch": torch_action,
    "theta": theta,
}


def difference(name: str, found: np.ndarray, wanted: np.ndarray) -> float:
    """Largest difference of a quantity."""
    if name == "theta":
        return float((np.abs(found[:, 0] - wanted[:, 0]) / wanted[:, 1]).max())
    return float(np.abs(found - wanted).max())


def values(inputs: Path, variant: str, quantities: tuple[str, ...]) -> dict[str, np.ndarray]:
    """Values of a variant, from a process of its own."""
    threads, switches = VARIANTS[variant]
    environment = {**os.environ, **dict.fromkeys(_THREADS, str(threads)), **switches}
    if "NUMBA_CPU_NAME" in switches:
        environment["NUMBA_CACHE_DIR"] = str(inputs / "kernels")
    command = [sys.executable, "-m", "benchmarks.hardening.agreement", str(inputs), str(threads), *quantities]
    done = subprocess.run(command, cwd=ROOT, env=environment, check=True, stdout=subprocess.PIPE, text=True)
    return {name: np.array(one) for name, one in json.loads(done.stdout.splitlines()[-1]).items()}


def run(
    out: Path,
    number: int,
    seed: int,
    variants: tuple[str, ...] = tuple(VARIANTS),
    quantities: tuple[str, ...] = tuple(QUANTITIES),
) -> dict[str, Any]:
    """Compare all variants with the first one; see `parts.Part.run`."""
    from tests.identification.samples import write_capture

    if "theta" in quantities and not (out / "push").exists():
        write_capture(out / "push")
    first = values(out, variants[0], quantities)
    found: dict[str, dict[str, float]] = {}
    for variant in variants[1:]:
        other = values(out, variant, quantities)
        found[variant] = {name: difference(name, other[name], first[name]) for name in quantities}
    wrong = [
        {"variant": variant, "quantity": name, "wrong": f"differs by {gap:.3g} {TOLERANCES[name][0]}"}
        for variant, gaps in found.items()
        for name, gap in gaps.items()
        if not gap <= TOLERANCES[name][1]
    ]
    return {"variants": found, "theta": first["theta"][:, 0].tolist() if "theta" in first else [], "violations": wrong}


def table(found: dict[str, Any]) -> str:
    """Figures as a table in Markdown."""
    names = list(found["variants"])
    rows = [f"| largest difference from 1 thread | {' | '.join(names)} | allowed |", "| --- " * (len(names) + 2) + "|"]
    for quantity in found["variants"][names[0]]:
        unit, most = TOLERANCES[quantity]
        gaps = " | ".join(f"{found['variants'][name][quantity]:.2g}" for name in names)
        rows.append(f"| {quantity}, {unit} | {gaps} | {most:g} |")
    return "\n".join(rows)


def main() -> None:
    """Print values as JSON; called by `run` in a process of its own."""
    inputs, threads = Path(sys.argv[1]), int(sys.argv[2])
    names, out, sys.stdout = sys.argv[3:], sys.stdout, sys.stderr
    print(json.dumps({name: QUANTITIES[name](threads, inputs).tolist() for name in names}), file=out)


if __name__ == "__main__":
    main()
