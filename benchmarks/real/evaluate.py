# SPDX-License-Identifier: MIT
"""Fit a twin to some pushes of a capture, predict the others, and store what was found."""

import json
import math
import time
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
import torch

from pinwm_drake.capture.episodes import ObjectPoses
from pinwm_drake.experiments.prediction import Prediction, predict
from pinwm_drake.experiments.twins import identify
from pinwm_drake.identification.options import IdentifyOptions
from pinwm_drake.spatial.rotations import turn_between
from pinwm_drake.twin.predict import TWO_SIDED
from pinwm_drake.twin.twin import Twin

# Of a slow push, which is the same at any step; of a fast one.
SLOW, FAST = 0.1, 1.0 / 240.0
_MOVES, _SCREENED, _STARTS = 4, 32, 1


def options(time_step: float, **changes: Any) -> IdentifyOptions:
    """Options of a fit to poses."""
    given = {"num_threads": 1, "moves": _MOVES, "screened": _SCREENED, "starts": _STARTS, "time_step": time_step}
    return IdentifyOptions(**(given | changes))


def fit_and_predict(
    capture: Path,
    twin: Path,
    fit: Sequence[str],
    test: Sequence[str],
    given: IdentifyOptions,
    *,
    poses: str | None = "object_poses.csv",
    find_start: bool = False,
) -> dict[str, Any]:
    """Figures of a twin of some pushes and of its predictions of others, by the product's calls."""
    begun = time.process_time()
    found = identify(capture, twin, episodes=fit, options=given, poses=poses).twin
    fitted = time.process_time()
    rows = [figures(predict(found, capture / "episodes" / name, find_start=find_start)) for name in test]
    estimates = {**found.theta, **{name: one for name, one in found.nuisance.items() if "." not in name}}
    return {
        "fit": list(fit),
        "cpu": {"fit": round(fitted - begun, 1), "predict": round(time.process_time() - fitted, 1)},
        "estimates": {name: [one.value, one.interval, one.identifiable] for name, one in estimates.items()},
        "frame": found.provenance.get("frame"),
        "noise": pose_noise(found),
        "predictions": rows,
    }


def pose_noise(twin: Twin) -> list[float] | None:
    """White noise of x, y [m] and yaw [rad] that a fit to measured poses takes; None where it was to images."""
    if "poses" not in twin.provenance:
        return None
    noise = twin.provenance["poses"]["noise"]
    return [*noise["position"][:2], noise["rotation"][2]]


def figures(found: Prediction) -> dict[str, Any]:
    """Errors of a prediction at the end, and over the path, against the measured poses; m, rad."""
    truth, poses, spread = found.episode.object_poses, found.poses, found.spread
    assert truth is not None
    errors = found.errors
    assert errors is not None
    assert spread is not None
    d = poses.p_WO[-1] - _last(truth, poses.t[-1])[0]
    yaw = _yaw(_last(truth, poses.t[-1])[1], poses.q_WO[-1])
    moved = np.linalg.norm(np.diff(truth.p_WO, axis=0), axis=1).sum()
    return {
        "push": found.episode.name,
        "end": [float(d[0]), float(d[1]), yaw],
        "spread": [float(spread.x[-1]), float(spread.y[-1]), float(spread.yaw[-1])],
        "path": [float(errors.position.mean()), float(errors.rotation.mean())],
        "moved": [float(moved), abs(_yaw(truth.q_WO[0], truth.q_WO[-1]))],
    }


def summary(case: Mapping[str, Any]) -> dict[str, float]:
    """Mean errors of predictions, mm and deg, at the end and over the path, and the share that intervals hold.

    Errors are against measured poses, so intervals count the noise of these.
    """
    rows = case["predictions"]
    end, spread = (np.array([row[key] for row in rows]) for key in ("end", "spread"))
    spread = np.hypot(spread, case.get("noise") or 0.0)
    path = np.array([row["path"] for row in rows])
    return {
        "mm": 1e3 * float(np.hypot(end[:, 0], end[:, 1]).mean()),
        "deg": math.degrees(float(np.abs(end[:, 2]).mean())),
        "path_mm": 1e3 * float(path[:, 0].mean()),
        "path_deg": math.degrees(float(path[:, 1].mean())),
        "cover": float((np.abs(end) <= TWO_SIDED * spread).mean()),
        "number": len(rows),
    }


def stored(path: Path, make: Any) -> dict[str, Any]:
    """Contents of a JSON file; made and written where it is not there."""
    if not path.is_file():
        path.parent.mkdir(parents=True, exist_ok=True)
        text = json.dumps(make(), indent=1)
        path.write_text(text + "\n")
    return dict(json.loads(path.read_text()))


def _last(truth: ObjectPoses, t: float) -> tuple[np.ndarray, np.ndarray]:
    k = int(np.searchsorted(truth.t, t + 1e-6)) - 1
    return truth.p_WO[k], truth.q_WO[k]


def _yaw(q_WA: np.ndarray, q_WB: np.ndarray) -> float:
    return float(turn_between(torch.from_numpy(q_WA), torch.from_numpy(q_WB))[2])
