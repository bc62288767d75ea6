# SPDX-License-Identifier: MIT
"""Twins of the captures from some of their pushes, and their predictions of the others."""

import itertools
import json
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from benchmarks.next_push.specification import CaptureSpec
from benchmarks.results import markdown
from pinwm_drake.capture.episodes import Episode, ObjectPoses, read_episode
from pinwm_drake.capture.ground_truth import GROUND_TRUTH_FILE
from pinwm_drake.capture.scene import Capture, load_capture
from pinwm_drake.experiments.alignment import align
from pinwm_drake.files import replacing
from pinwm_drake.identification.identify import identify_theta
from pinwm_drake.identification.options import IdentifyOptions
from pinwm_drake.rendering.ply import read_ply
from pinwm_drake.rendering.surfels import Surfels
from pinwm_drake.report.surfels.fit_results import ALIGN_FILE, read_offset, read_registration
from pinwm_drake.report.twin.data import read_ground_truth
from pinwm_drake.spatial.poses import Pose
from pinwm_drake.twin.predict import predict_motion
from pinwm_drake.twin.twin import SURFELS_FILE, Estimate, Twin

METHODS = ("ours", "pin-wm", "truth", "still")
# The paper's way: frictions and moments alone, of one push, with an even pressure and everything as it was written.
_PIN_WM = IdentifyOptions(free=("friction_floor", "friction_pusher", "moment_xx", "moment_yy"), support="patch")
SETS: dict[int, tuple[tuple[int, ...], ...]] = {
    0: ((),),
    1: ((0,), (1,), (2,), (3,)),
    2: ((0, 1), (2, 3)),
    3: ((0, 1, 2), (1, 2, 3)),
}
_Errors = dict[str, Any]


def evaluate(out: Path, kind: str, spec: CaptureSpec, method: str, chosen: tuple[int, ...]) -> _Errors:
    """Return the result of a capture, which is kept in `OUT/results/KIND/NAME.METHOD.PUSHES.json`.

    Args:
        out: Folder of the benchmark, with its captures.
        kind: Either "clean" or "realistic".
        spec: The capture.
        method: One of `METHODS`.
        chosen: Pushes that the twin is identified from; none for methods that need none.
    """
    path = result_path(out, kind, spec, method, chosen)
    if not path.exists():
        found = _evaluate(out, kind, spec, method, chosen)
        path.parent.mkdir(parents=True, exist_ok=True)
        with replacing(path) as temporary:
            temporary.write_text(json.dumps(found, indent=1) + "\n", encoding="utf-8")
    return dict(json.loads(path.read_text(encoding="utf-8")))


def result_path(out: Path, kind: str, spec: CaptureSpec, method: str, chosen: tuple[int, ...]) -> Path:
    """File of a result."""
    pushes = "-".join(str(push) for push in chosen) or "none"
    return out / "results" / kind / f"{spec.name}.{method}.{pushes}.json"


def _evaluate(out: Path, kind: str, spec: CaptureSpec, method: str, chosen: tuple[int, ...]) -> _Errors:
    capture = load_capture(out / kind / spec.name)
    episodes = [read_episode(capture, name) for name in capture.episode_names]
    truth = read_ground_truth(capture.folder / GROUND_TRUTH_FILE)
    result: _Errors = {"capture": spec.name, "split": spec.split, "method": method, "pushes": list(chosen)}
    if method == "still":
        return result | {"predictions": [_score(still(capture, one), one) for one in episodes]}
    surfels, offset, X_OS = appearance(out, kind, spec)
    if method == "truth":
        twin = _true_twin(capture, episodes[0], (surfels, offset, X_OS), truth)
    else:
        options = _PIN_WM if method == "pin-wm" else IdentifyOptions()
        found = identify_theta(capture, [episodes[k] for k in chosen], surfels, offset, options, X_OS=X_OS)
        twin = found.twin
        result |= {
            "seconds": round(found.found.seconds, 1),
            "loss": found.found.loss,
            "fit": [_score(poses, episodes[k]) for k, poses in zip(chosen, found.poses, strict=True)],
            "theta": {name: [one.value, one.interval] for name, one in (twin.theta | twin.nuisance).items()},
            "truth": truth,
        }
    others = [one for k, one in enumerate(episodes) if k not in chosen]
    return result | {"predictions": [_prediction(twin, capture, one) for one in others]}


def appearance(out: Path, kind: str, spec: CaptureSpec) -> tuple[Surfels, tuple[float, float], Pose]:
    """Surfels of a capture, the offset of its cameras, and where they have the object, aligned once."""
    folder = out / "twins" / kind / spec.name
    if not (folder / ALIGN_FILE).exists():
        align(out / kind / spec.name, folder)
    path = folder / ALIGN_FILE
    return read_ply(folder / SURFELS_FILE), read_offset(path), read_registration(path)


def _true_twin(
    capture: Capture,
    episode: Episode,
    appearance: tuple[Surfels, tuple[float, float], Pose],
    truth: dict[str, float],
) -> Twin:
    """Twin with the true parameters that a capture tells: masses and frictions, on a face that presses evenly."""
    blank = IdentifyOptions(
        screened=1, starts=1, coarse_iterations=0, fine_iterations=0, moves=2, free=("lift",), support="patch"
    )
    surfels, offset, X_OS = appearance
    twin = identify_theta(capture, episode, surfels, offset, blank, X_OS=X_OS).twin
    theta = {name: replace(one, value=truth.get(name, one.value)) for name, one in twin.theta.items()}
    lift = Estimate(0.0, None, False, "m")
    floor = capture.floor_height
    return replace(twin, theta=theta, nuisance=twin.nuisance | {"lift": lift}, floor_height=floor, draws=None)


def _prediction(twin: Twin, capture: Capture, episode: Episode) -> _Errors:
    poses, spread = predict_motion(twin, capture, episode, None)
    result = _score(poses, episode)
    if spread is not None:
        result["spread"] = [float(values[-1]) for values in (spread.x, spread.y, spread.yaw)]
    return result


def still(capture: Capture, episode: Episode) -> ObjectPoses:
    """Poses of an object that nothing moves."""
    n = len(episode.t)
    X_WO = capture.object.X_WO
    return ObjectPoses(episode.t, np.tile(X_WO.p.numpy(), (n, 1)), np.tile(X_WO.q.numpy(), (n, 1)))


def _score(poses: ObjectPoses, episode: Episode) -> _Errors:
    """Mean and last errors of poses: in the plane [m], and of the yaw [rad]."""
    truth = episode.object_poses
    if truth is None:
        raise ValueError(f"{episode.folder} has no object_poses.csv")
    level = poses.p_WO[:, :2] - truth.p_WO[:, :2]
    yaw = _yaw(poses.q_WO) - _yaw(truth.q_WO)
    yaw = (yaw + np.pi) % (2 * np.pi) - np.pi
    return {
        "episode": episode.name,
        "position": float(np.linalg.norm(level, axis=1).mean()),
        "yaw": float(np.abs(yaw).mean()),
        "last": [*level[-1].tolist(), float(yaw[-1])],
    }


def _yaw(q: np.ndarray) -> np.ndarray:
    w, x, y, z = q.T
    return np.asarray(np.arctan2(2.0 * (w * z + x * y), 1.0 - 2.0 * (y * y + z * z)))


def summary(results: list[_Errors]) -> str:
    """Errors of the predictions in a line: mm and degrees of each."""
    scores = [score for one in results for score in one["predictions"]]
    return " ".join(f"{1e3 * score['position']:.1f}/{np.degrees(score['yaw']):.1f}" for score in scores)


def table(results: list[_Errors]) -> list[str]:
    """Lines of a table in Markdown: errors of the predictions by method and number of pushes."""
    rows = []

    def key(one: _Errors) -> tuple[str, int]:
        return one["method"], len(one["pushes"])

    for (method, number), group in itertools.groupby(sorted(results, key=key), key=key):
        rows.append([method, number or "", *cells(list(group))])
    header = "method | pushes | predictions | median | nine of ten | worst | 95 % intervals of the last pose cover"
    return markdown(header, rows)


def cells(results: list[_Errors]) -> list[str]:
    """Cells of a row: predictions, median, nine of ten, worst, and the share of last poses that intervals hold."""
    scores = [score for one in results for score in one["predictions"]]
    errors = np.array([[1e3 * score["position"], np.degrees(score["yaw"])] for score in scores])
    inside = [
        abs(last) < 1.96 * sigma
        for score in scores
        if "spread" in score
        for last, sigma in zip(score["last"], score["spread"], strict=True)
    ]
    cover = f"{100 * np.mean(inside):.0f} % of {len(inside)}" if inside else ""
    return [str(len(scores)), *(_pair(np.quantile(errors, share, axis=0)) for share in (0.5, 0.9, 1.0)), cover]


def _pair(errors: np.ndarray) -> str:
    return f"{errors[0]:.2f} mm, {errors[1]:.2f}°"
