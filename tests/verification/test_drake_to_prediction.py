# SPDX-License-Identifier: MIT
"""From Drake's plant through images to a twin that predicts another push: nobody here knows theta but the scorer."""

import numpy as np
import pytest

from pinwm_drake.capture.episodes import read_episode
from pinwm_drake.capture.ground_truth import GROUND_TRUTH_FILE
from pinwm_drake.capture.scene import load_capture
from pinwm_drake.experiments.twins import identify
from pinwm_drake.identification.options import IdentifyOptions
from pinwm_drake.rendering.fit_options import FitOptions
from pinwm_drake.report.twin.data import read_ground_truth
from pinwm_drake.report.twin.score import pose_errors
from pinwm_drake.systems.runs.capture_options import SimulateOptions
from pinwm_drake.systems.runs.simulated_capture import simulate_capture
from pinwm_drake.twin.predict import TWO_SIDED, predict_poses, predict_spread

DEFAULTS = {
    "object_name": "cube", "friction": 0.2, "pusher_friction": 0.3, "mass": 0.5, "restitution": 0.0, "seed": 0,
    "size": 400, "episodes": 3, "static_views": 12, "frames": 40, "rate": 24.0, "speed": None, "distance": 0.08,
    "pusher": "sphere", "pusher_radius": 0.01, "lying": False, "supersampling": 3,
}  # fmt: skip
SMALL_FIT = FitOptions(iterations=500, max_surfels=1200, sh_degree=1)
SMALL_SEARCH = IdentifyOptions(screened=24, starts=2, coarse_iterations=25, fine_iterations=4, moves=16,
                               coarse_size=24.0, fine_size=64.0, coarse_frames=8, fine_frames=16)  # fmt: skip


def predicted(folder, *, identified, fit=None, search=None, **options):
    """Truth, estimates, and of each other push: errors (n,) of frames [m, rad], way [m], and last errors in sigmas."""
    simulate_capture(SimulateOptions(**(DEFAULTS | options)), folder / "capture")
    capture = load_capture(folder / "capture")
    # What scores is out of reach of what is scored.
    names = capture.episode_names
    truths = {name: read_episode(capture, name).object_poses for name in names}
    theta = read_ground_truth(capture.folder / GROUND_TRUTH_FILE)
    (capture.folder / GROUND_TRUTH_FILE).unlink()
    for name in names:
        (capture.folder / "episodes" / name / "object_poses.csv").unlink()
    found = identify(capture.folder, folder / "twin", episodes=names[:identified], options=search, fit_options=fit)
    rows = []
    for name in names[identified:]:
        episode = read_episode(capture, name)
        poses, truth = predict_poses(found.twin, capture, episode, None), truths[name]
        spread = predict_spread(found.twin, capture, episode, None)
        errors = pose_errors(poses, truth)
        way = float(np.linalg.norm(truth.p_WO[-1] - truth.p_WO[0]))
        last = (poses.p_WO[-1] - truth.p_WO[-1])[:2] / [spread.x[-1], spread.y[-1]]
        rows.append((errors.position.mean(), errors.rotation.mean(), way, last))
    return theta, found.twin, rows


@pytest.mark.nightly
def test_a_twin_of_drake_predicts_the_next_push(tmp_path):
    theta, twin, rows = predicted(
        tmp_path, identified=1, fit=SMALL_FIT, search=SMALL_SEARCH,
        size=128, episodes=2, static_views=8, frames=24, rate=16.0, supersampling=2,
    )  # fmt: skip
    friction = twin.theta["friction_floor"]
    assert friction.value == pytest.approx(theta["friction_floor"], rel=0.25)
    assert friction.interval[0] < theta["friction_floor"] < friction.interval[1]
    ((position, rotation, way, _),) = rows
    assert way > 0.03
    assert position < 0.1 * way
    assert rotation < np.radians(8)


@pytest.mark.nightly
@pytest.mark.parametrize(
    "options",
    [
        {"object_name": "t_block", "friction": 0.1, "seed": 1},
        {"object_name": "mug", "friction": 0.3, "seed": 2},
        {"object_name": "cube", "friction": 0.15, "seed": 3, "realistic": True},
    ],
    ids=["t_block", "mug", "cube, realistic"],
)
def test_twins_of_drake_predict_next_pushes(options, tmp_path):
    theta, twin, rows = predicted(tmp_path, identified=1, **options)
    # Twice the clean captures' bars for a realistic one.
    factor = 2.0 if options.get("realistic") else 1.0
    friction = twin.theta["friction_floor"]
    assert friction.value == pytest.approx(theta["friction_floor"], rel=0.15 * factor)
    for position, rotation, _, last in rows:
        assert position < 6e-3 * factor
        assert rotation < np.radians(5 * factor)
        assert (np.abs(last) < 2.0 * TWO_SIDED).all()
