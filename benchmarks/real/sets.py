# SPDX-License-Identifier: MIT
"""The sets of the benchmark: which pushes are fitted, and which are predicted."""

import shutil
from collections.abc import Iterable
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np

from benchmarks.real import captures
from benchmarks.real.evaluate import FAST, SLOW, fit_and_predict, options, stored
from benchmarks.results import machine
from pinwm_drake.identification.options import IdentifyOptions

TRIES = 3  # of one push
# Spread of the pressure of CMU's points against that of an even one, along x and y.
POINTS = {"10_130": (1.6, 1.6), "30_90": (0.8, 0.8), "10_90": (1.13, 1.33), "patch": (1.0, 1.0)}
_TRIANGLE_FIT = 10
# Unknowns of a slow push in the plane: the others have no part in it.
PLANAR = (
    *("friction_floor", "friction_pusher", "support_x", "support_y", "center_x", "center_y", "contact_offset"),
    *("frame_x", "frame_y", "frame_yaw", "start_x", "start_y", "start_yaw", "grip_floor", "grip_pusher"),
)
_TOSS_FIT, _TOSS_FRAMES = 48, 12
_STEEL_FITS = (("0000",), ("0000", "0005"))


@dataclass(frozen=True)
class Job:
    """One twin and its predictions: where its figures are stored, what is known of it, and how it is made."""

    path: Path
    about: dict[str, Any]
    make: partial[dict[str, Any]]

    def run(self) -> dict[str, Any]:
        """Figures, made where they are not stored yet."""
        return stored(self.path, lambda: self.about | {"machine": machine()} | self.make())


def mit(data: Path, out: Path, tests: int) -> Iterable[Job]:
    """MIT's quasi-static pushes: each pair by one push (three tries), 5 and 20 of those that CMU trained with."""
    pairs = [_pair(path, out, tests) for path in sorted((data / "mit_quasistatic").glob("*.npz"))]
    for number, seed in ((1, 0), (5, 0), (20, 0), *((1, seed) for seed in range(1, TRIES))):
        for folder, train, others, about in pairs:
            fit = np.random.default_rng(seed).permutation(train)[:number].tolist()
            twin = out / "twins" / f"mit-{folder.name}-{number}-{seed}"
            make = partial(fit_and_predict, folder, twin, _names(fit), _names(others), options(SLOW, free=PLANAR))
            yield Job(out / f"{twin.name}.json", about | {"number": number, "seed": seed}, make)


def _pair(path: Path, out: Path, tests: int) -> tuple[Path, int, range, dict[str, Any]]:
    """Capture of one of MIT's pairs, the number of pushes to fit, those to predict, and what is known of it."""
    arrays = np.load(path)
    train, test = arrays["train"], arrays["test"]
    chosen = np.linspace(0, len(test) - 1, min(tests, len(test))).round().astype(int)
    test = test[chosen]
    cmu = {
        name: _mean_errors(arrays[key][chosen], test[:, 3:6])
        for name, key in (("quartic", "zhou_poly4"), ("quadratic", "zhou_quadratic"))
    }
    pushes = [captures.mit_push(row) for row in (*train, *test)]
    folder = out / "captures" / path.stem
    _anew(folder, partial(captures.write_mit, name=path.stem, pushes=pushes))
    about = {"set": "mit", "name": path.stem, "cmu": cmu, "still": _mean_errors(test[:, :3], test[:, 3:6])}
    return folder, len(train), range(len(train), len(pushes)), about


def triangle(data: Path, out: Path, tests: int) -> Iterable[Job]:
    """CMU's triangle on points that are known: each set by 10 of its pushes, evenly spaced."""
    for path in sorted((data / "cmu_triangle").glob("*.npz")):
        pushes = captures.triangle_pushes(dict(np.load(path)))
        folder = out / "captures" / path.stem
        _anew(folder, partial(captures.write_triangle, name=path.stem, pushes=pushes))
        fit = np.linspace(0, len(pushes) - 1, _TRIANGLE_FIT).round().astype(int).tolist()
        others = [k for k in range(len(pushes)) if k not in fit][:tests]
        still = _mean_errors(*np.stack([pushes[k].poses for k in others], 1))
        points = next(points for key, points in POINTS.items() if key in path.stem)
        about = {"set": "triangle", "name": path.stem, "number": len(fit), "points": points, "still": still}
        twin = out / "twins" / f"triangle-{path.stem}"
        make = partial(fit_and_predict, folder, twin, _names(fit), _names(others), options(SLOW, free=PLANAR))
        yield Job(out / f"{twin.name}.json", about, make)


def steel(data: Path, out: Path, tests: int, *, images: bool = False) -> Iterable[Job]:
    """MIT's steel plate, by poses or by images: from one push and from two, the others predicted."""
    folder = data / "mit_steel_capture"
    names = sorted(path.name for path in (folder / "episodes").iterdir())
    for fit in _STEEL_FITS:
        kind = "images" if images else "poses"
        twin = out / "twins" / f"steel-{kind}-{len(fit)}"
        if images and len(fit) > 1:
            _copy_surfels(out / "twins" / "steel-images-1", twin)
        others = [name for name in names if name not in fit][:tests]
        given = IdentifyOptions(num_threads=1) if images else options(FAST)
        make = partial(fit_and_predict, folder, twin, fit, others, given, poses=None if images else "object_poses.csv")
        about = {"set": f"steel-{kind}", "name": "mit_steel_capture", "number": len(fit)}
        yield Job(out / f"{twin.name}.json", about, make)


def images(data: Path, out: Path, tests: int) -> Iterable[Job]:
    """MIT's steel plate by images."""
    return steel(data, out, tests, images=True)


def tosses(data: Path, out: Path, tests: int) -> Iterable[Job]:
    """Tosses of a cube: 48 to fit, others to test."""
    thrown = captures.read_tosses(data / "contactnets/tosses.npz")
    folder = out / "captures" / "contactnets"
    _anew(folder, partial(captures.write_tosses, tosses=thrown))
    order = np.random.default_rng(0).permutation(len(thrown)).tolist()
    fit, others = order[:_TOSS_FIT], order[_TOSS_FIT:][:tests]
    free = ("friction_floor", "restitution_floor", "contact_offset", "lift")
    given = options(FAST, fine_frames=_TOSS_FRAMES, free=free, held={"friction_pusher": 0.2}, moves=2)
    twin = out / "twins" / "contactnets"
    make = partial(fit_and_predict, folder, twin, _names(fit), _names(others), given)
    about = {"set": "tosses", "name": "contactnets", "number": len(fit)}
    yield Job(out / f"{twin.name}.json", about, make)


SETS = {"mit": mit, "triangle": triangle, "steel": steel, "images": images, "tosses": tosses}


def _names(numbers: Iterable[int]) -> list[str]:
    return [f"{number:04}" for number in numbers]


def _mean_errors(found: np.ndarray, true: np.ndarray) -> list[float]:
    """Mean errors of planar poses (n, 3), mm and deg."""
    d = found - true
    turn = (d[:, 2] + np.pi) % (2.0 * np.pi) - np.pi
    return [1e3 * float(np.hypot(d[:, 0], d[:, 1]).mean()), float(np.degrees(np.abs(turn)).mean())]


def _anew(folder: Path, write: partial[Path]) -> None:
    """Write a capture where there is none that is whole."""
    if not (folder / "capture.yaml").is_file():
        shutil.rmtree(folder, ignore_errors=True)
        write(folder)


def _copy_surfels(source: Path, target: Path) -> None:
    target.mkdir(parents=True, exist_ok=True)
    for name in ("surfels.ply", "align.json"):
        if (source / name).is_file():
            shutil.copy(source / name, target / name)
