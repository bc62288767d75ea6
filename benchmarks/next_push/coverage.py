# SPDX-License-Identifier: MIT
"""Coverage of intervals: short captures with theta drawn at random, and where the truth lies among a twin's draws."""

import json
import tempfile
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
import torch
from scipy.stats import binomtest

from benchmarks.next_push.captures import write_capture
from benchmarks.next_push.objects import OBJECTS, make_thing
from benchmarks.next_push.poses import pose_capture
from benchmarks.next_push.specification import ENGINES, CaptureSpec
from benchmarks.results import markdown
from pinwm_drake.capture.episodes import read_episode
from pinwm_drake.capture.scene import load_capture
from pinwm_drake.experiments.alignment import align
from pinwm_drake.files import replacing
from pinwm_drake.geometry.meshes import half_diagonal
from pinwm_drake.identification.identify import identify_theta
from pinwm_drake.identification.options import IdentifyOptions
from pinwm_drake.rendering.ply import read_ply
from pinwm_drake.report.style import GREY, TWIN, new_figure, tidy
from pinwm_drake.report.surfels.fit_results import ALIGN_FILE, read_offset
from pinwm_drake.spatial.poses import Pose
from pinwm_drake.spatial.rotations import turn_between
from pinwm_drake.twin.drift import DRIFT, DRIFT_TURN, drift, way
from pinwm_drake.twin.rollout import rollout_draws
from pinwm_drake.twin.twin import SURFELS_FILE

_SEED, _SIZE, _VIEWS = 5000, 200, 12
# Less than the default search: small pictures of few frames.
_OPTIONS = IdentifyOptions(coarse_frames=10, fine_frames=20, fine_size=80.0, starts=3, coarse_iterations=40, moves=40)
_LEVELS = (0.5, 0.8, 0.95)
_BINS = 10
_WORLDS = 200
Row = dict[str, Any]


def coverage_case(out: Path, number: int) -> Row:
    """Ranks of the truth among the draws of one capture's twin, kept in `OUT/coverage/NUMBER.json`.

    The twin is identified from one push, and predicts another one; objects and engines take turns.

    Args:
        out: Folder of the benchmark.
        number: Number of the capture, from 0 on; seed of its theta and pushes.
    """
    path = out / "coverage" / f"{number:03d}.json"
    if not path.exists():
        path.parent.mkdir(parents=True, exist_ok=True)
        with replacing(path) as temporary:
            temporary.write_text(json.dumps(_case(out, number)) + "\n", encoding="utf-8")
    return dict(json.loads(path.read_text(encoding="utf-8")))


def _case(out: Path, number: int) -> Row:
    objects = list(OBJECTS)
    name, engine = objects[number % len(objects)], ENGINES[number // len(objects) % len(ENGINES)]
    thing = make_thing(name, out / "objects")
    spec = CaptureSpec(f"{name}_{engine}", name, engine, "unseen", _SEED + number, "sphere")
    looks = out / "coverage" / "looks" / name
    with tempfile.TemporaryDirectory() as folder:
        there = looks / ALIGN_FILE
        posed = pose_capture(spec, thing, number=2)
        views = 1 if there.exists() else _VIEWS
        write_capture(Path(folder) / "capture", spec, thing, posed, pixels=_SIZE, views=views)
        if not there.exists():
            align(Path(folder) / "capture", looks)
        capture = load_capture(Path(folder) / "capture")
        episodes = [read_episode(capture, one) for one in capture.episode_names]
        surfels, offset = read_ply(looks / SURFELS_FILE), read_offset(there)
        twin = identify_theta(capture, episodes[0], surfels, offset, _OPTIONS).twin
        assert twin.draws is not None
        truth = {"friction_floor": posed.theta.friction_floor, "friction_pusher": posed.theta.friction_pusher}
        ranks = {key: float((twin.draws.column(key) < value).mean()) for key, value in truth.items()}
        # Where the next push leaves the object, with the drift that every push has.
        rows, episode = twin.draws.rows(_WORLDS), episodes[1]
        X_WO = rollout_draws(twin, capture.object.X_WO, episode.trajectory, episode.t, rows)
    generator = np.random.default_rng([_SEED, number])
    radius = half_diagonal(thing.mesh())
    made = way(Pose(X_WO.q.swapaxes(0, 1), X_WO.p.swapaxes(0, 1)), torch.from_numpy(episode.t), radius)[:, -1].numpy()
    drifts = np.stack([twin.draws.column(name)[rows] for name in (DRIFT, DRIFT_TURN)], -1)
    sigma = np.stack([drift(radius, *one).numpy()[[2, 3, 4]] for one in drifts])
    last = np.column_stack([turn_between(X_WO.q[-1, :1], X_WO.q[-1])[:, 2], X_WO.p[-1, :, :2]])
    last = last + np.sqrt(made)[:, None] * sigma * generator.normal(size=sigma.shape)
    true = episode.object_poses
    assert true is not None
    turned = turn_between(X_WO.q[-1, :1], torch.from_numpy(true.q_WO[-1:]))[0, 2]
    values = np.array([float(turned), *true.p_WO[-1, :2]])
    ranks |= {key: float((last[:, k] < values[k]).mean()) for k, key in enumerate(("yaw", "x", "y"))}
    return {"number": number, "capture": spec.name, "truth": truth, "ranks": ranks}


def coverage_table(rows: Sequence[Row]) -> list[str]:
    """Lines of a table in Markdown: shares of truths within central intervals, each with its Wilson interval."""
    rows_of_table = []
    for words, keys in _QUANTITIES.items():
        ranks = np.array([row["ranks"][key] for row in rows for key in keys])
        cells = []
        for level in _LEVELS:
            inside = int((np.abs(ranks - 0.5) <= 0.5 * level).sum())
            low, high = binomtest(inside, len(ranks)).proportion_ci(method="wilson")
            cells.append(f"{100 * inside / len(ranks):.0f} % ({100 * low:.0f} to {100 * high:.0f})")
        rows_of_table.append([words, len(ranks), *cells])
    return markdown(" | ".join(["quantity | captures", *(f"within {100 * x:.0f} %" for x in _LEVELS)]), rows_of_table)


_QUANTITIES = {
    "friction of the floor": ("friction_floor",),
    "friction of the pusher": ("friction_pusher",),
    "place after the next push (x, y)": ("x", "y"),
    "yaw after the next push": ("yaw",),
}


def rank_histogram(path: Path, rows: Sequence[Row]) -> None:
    """Draws how often the truth has which rank among the draws, with the range that 95 % of even ones would be in."""
    figure = new_figure(10.0, 2.8)
    panels = figure.subplots(1, len(_QUANTITIES), sharey=True)
    for axes, (words, keys) in zip(panels, _QUANTITIES.items(), strict=True):
        ranks = np.array([row["ranks"][key] for row in rows for key in keys])
        counts, edges = np.histogram(ranks, _BINS, (0.0, 1.0))
        share = _BINS * counts / len(ranks)
        axes.bar(edges[:-1], share, 1.0 / _BINS, align="edge", color=TWIN, alpha=0.7, edgecolor="white")
        wide = 1.96 * np.sqrt((_BINS - 1) / len(ranks))
        axes.axhspan(1.0 - wide, 1.0 + wide, color=GREY, alpha=0.25, linewidth=0)
        axes.set_title(words, fontsize=9)
        axes.set_xlabel("rank of the truth")
    panels[0].set_ylabel("against even")
    tidy(panels)
    with replacing(path) as temporary:
        figure.savefig(temporary, format="png")
