# SPDX-License-Identifier: MIT
"""Calibration of rendered labs beside their truth, over seeds.

    python -m benchmarks.calibration [--seeds N] [--write]

Each lab has 12 photos of a board anywhere, 20 with the robot's poses and 4 of the table (1280 x 720, noise, blur,
JPEG). A point of the workspace is off by the length across the ray to where it is seen. Intervals are those that a
calibration tells, 95 %.
"""

import argparse
import datetime
import json
import tempfile
import time
from pathlib import Path
from typing import Any

import numpy as np

from benchmarks import timing

if __name__ == "__main__":
    timing.limit_threads(1)

import cv2
from scipy.stats import f as fisher

from benchmarks.results import machine, markdown, verdict
from benchmarks.scenes.rendered_lab import WORKSPACE, RenderedLab
from pinwm_drake.spatial.rigid import apply, inverse
from pinwm_drake.station.accuracy import CONFIDENCE, across, degrees_of_freedom, seen_spread, within
from pinwm_drake.station.calibrate import Calibration, calibration_of
from pinwm_drake.station.lab import WorkspaceDocument, load_lab

RESULT = Path(__file__).resolve().parent.parent / "docs/results/calibration.json"
CASES: dict[str, dict[str, Any]] = {
    "fixed camera": {},
    "fixed camera, fisheye": {"model": "fisheye"},
    "camera in the hand": {"mount": "hand"},
    "fixed camera, robot 0.1 mm, 0.02 deg": {"place_noise": 1e-4, "turn_noise": 0.02},
}
MEDIAN, WORST, HEIGHT, TILT, COVER = 0.5, 1.5, 0.5, 0.2, 0.9  # bars: mm, mm, mm, degrees, share


def score(truth: RenderedLab, found: Calibration) -> dict[str, float]:
    """Errors of a calibration [mm, degrees], and whether its intervals hold them (share of points, or 0 and 1)."""
    solution = found.solution
    box = WorkspaceDocument.model_validate(WORKSPACE)
    points = apply(truth.X_BT, box.points())  # on the true table
    limit = 2.0 * fisher.ppf(CONFIDENCE, 2, degrees_of_freedom(solution))
    errors, held = [], []
    for X_BE in [None] if truth.mount == "fixed" else truth.grippers:
        X_BC, X_found = truth.X_BC, solution.camera.X
        if X_BE is not None:
            X_BC, X_found = X_BE @ truth.X_EC, X_BE @ X_found
        shown, spread = seen_spread(solution, points, X_BE)
        both = within(truth.lens, apply(inverse(X_BC), points[shown]))
        shown, spread = shown[both], spread[both]
        off = solution.lens.project(apply(inverse(X_found), points[shown])) - truth.lens.project(
            apply(inverse(X_BC), points[shown])
        )
        M = across(truth.lens, inverse(X_BC), points[shown])
        errors.append(np.linalg.norm((M @ off[..., None])[..., 0], axis=1))
        held.append((off[:, None] @ np.linalg.inv(spread) @ off[..., None]).ravel() < limit)
    error = 1e3 * np.concatenate(errors)
    middle = apply(truth.X_BT, np.mean([box.low, box.high], 0))
    table, reached = solution.table, found.accuracy
    height = _height(table.X, middle) - _height(truth.X_BT, middle)
    tilt = float(np.arccos(np.clip(table.X[:3, 2] @ truth.X_BT[:3, 2], -1.0, 1.0)))
    return {
        "median": float(np.median(error)),
        "worst": float(error.max()),
        "points_held": float(np.mean(np.concatenate(held))),
        "median_told": 1e3 * reached.median,
        "worst_told": 1e3 * reached.worst,
        "height": 1e3 * abs(height),
        "height_held": float(abs(height) < reached.height),
        "tilt": float(np.degrees(tilt)),
        "tilt_held": float(tilt < reached.tilt),
        "robot_noise": 1e3 * float(solution.bundle.noise.place),
    }


def _height(X_BT: np.ndarray, place: np.ndarray) -> float:
    """Height [m] of a table (4, 4) at x and y of a place (3,) in the robot's base."""
    n = X_BT[:3, 2]
    return float((n @ X_BT[:3, 3] - n[:2] @ place[:2]) / n[2])


def measure(seeds: int, names: list[str]) -> dict[str, Any]:
    """Scores of cases and seeds."""
    cv2.setNumThreads(1)
    cases: dict[str, Any] = {}
    for name in names:
        rows, settings = [], CASES[name]
        for seed in range(seeds):
            with tempfile.TemporaryDirectory() as folder:
                truth = RenderedLab(seed, **settings)
                lab = load_lab(truth.write(Path(folder)))
                began = time.process_time()
                found = calibration_of(lab)
                rows.append({"seed": seed, **score(truth, found), "cpu_s": time.process_time() - began})
            print(name, {key: round(value, 3) for key, value in rows[-1].items()}, flush=True)
        cases[name] = rows
    return cases


def table(cases: dict[str, Any]) -> str:
    """Table of the cases."""
    rows = []
    for name, found in cases.items():
        values = _columns(found)
        rows.append(
            (
                name,
                len(found),
                f"{np.median(values['median']):.2f}",
                f"{values['worst'].max():.2f}",
                f"{100 * values['points_held'].mean():.0f} %",
                f"{values['height'].max():.2f}",
                f"{100 * values['height_held'].mean():.0f} %",
                f"{values['tilt'].max():.3f}",
                f"{100 * values['tilt_held'].mean():.0f} %",
                f"{np.median(values['cpu_s']):.1f}",
            )
        )
    header = (
        "case | seeds | points, median mm | points, worst mm | ellipses that hold | table, worst mm | intervals that "
        "hold | tilt, worst deg | intervals that hold | CPU, s"
    )
    return "\n".join(markdown(header, rows))


def bars(cases: dict[str, Any]) -> str:
    """Bars of the cases, with what was found."""
    lines = []
    for name, found in cases.items():
        values = _columns(found)
        median, worst = float(np.median(values["median"])), float(values["worst"].max())
        points = float(values["points_held"].mean())
        lines.append(
            f"- {name}: median {verdict(median, MEDIAN)}; worst {verdict(worst, WORST)}; intervals of points "
            f"{verdict(points, COVER, at_most=False)}; table, mm {verdict(float(np.median(values['height'])), HEIGHT)} "
            f"(worst {values['height'].max():.2f}), degrees {verdict(float(values['tilt'].max()), TILT)}."
        )
    return "\n".join(lines)


def _columns(rows: list[dict[str, float]]) -> dict[str, np.ndarray]:
    return {key: np.array([row[key] for row in rows]) for key in rows[0]}


def main() -> None:
    """Run the benchmark, print its table and store its figures if asked to."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--seeds", type=int, default=20)
    parser.add_argument("--write", action="store_true", help="update docs/results/calibration.json")
    parser.add_argument("--case", nargs="+", choices=list(CASES), default=list(CASES))
    given = parser.parse_args()
    cases = measure(given.seeds, given.case)
    print(table(cases), bars(cases), sep="\n\n")
    if given.write:
        # Cases that were not run stay as they are.
        stored = json.loads(RESULT.read_text()) if RESULT.exists() else {"cases": {}}
        about = {"command": f"python -m benchmarks.calibration --seeds {given.seeds}", "machine": machine()}
        found = {
            name: {**about, "date": datetime.date.today().isoformat(), "seeds": rows} for name, rows in cases.items()
        }
        stored["cases"] |= found
        RESULT.write_text(json.dumps(stored, indent=1) + "\n")


if __name__ == "__main__":
    main()
