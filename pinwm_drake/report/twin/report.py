# SPDX-License-Identifier: MIT
"""The report of a twin: one page that loads nothing from anywhere."""

from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from matplotlib.figure import Figure

from pinwm_drake.capture.pusher import pusher_surface
from pinwm_drake.geometry.meshes import load_mesh
from pinwm_drake.identification.history import History
from pinwm_drake.report.figures.history import loss_figure, theta_figure
from pinwm_drake.report.figures.poses import error_figure, motion_figure, top_figure
from pinwm_drake.report.page import write_page
from pinwm_drake.report.style import evenly
from pinwm_drake.report.twin.comparison_frames import PANELS, Cast, Shot, draw_shots
from pinwm_drake.report.twin.data import Story
from pinwm_drake.report.twin.score import PoseErrors, pose_errors
from pinwm_drake.twin.frame import in_world
from pinwm_drake.twin.twin import Twin
from pinwm_drake.twin.words import doubt_words

_PANEL, _MOST_SHOTS, _STRIPS = 360, 64, 6  # px and frames of the player, frames of the strips


# By the intersection over union of the outlines in image and rendering, on average over the frames.
_GRADES = (
    (0.95, "good", "The twin reproduces the video"),
    (0.85, "fair", "The twin follows the video roughly"),
    (-np.inf, "poor", "The twin does not reproduce the video"),
)
_CLOSE = 0.05  # relative, of losses that count as the same


@dataclass(frozen=True)
class Verdict:
    """Verdict on a twin, in words."""

    status: str  # "good", "fair", "poor" or, without pictures, "unknown"
    headline: str
    lines: list[str]  # grounds of the verdict, one sentence each


def write_twin_report(path: Path, story: Story, report: Callable[[float], None] = lambda share: None) -> Verdict:
    """Write the report of a twin, and return its verdict; `report` hears the share of the pictures that is done.

    Raises:
        InputError: An image of the capture cannot be used, or the file cannot be written.
    """
    twin = story.twin
    shots = story.attempt(lambda: _draw(story, report), "So there are no pictures here.") or []
    truth = None if story.episode is None else story.episode.object_poses
    errors = None if truth is None or story.poses is None else pose_errors(story.poses, truth)
    verdict = _judge(twin, shots, errors, story.history)
    fitted = "poses" in twin.provenance
    of = "the measured pose" if fitted else "ground truth"
    chosen = [shots[k] for k in evenly(len(shots), _STRIPS)] if shots else []
    provenance = dict(twin.provenance)
    spent = provenance.pop("timings", None)
    write_page(
        path,
        "report/twin/report.html",
        story=story,
        verdict=verdict,
        truth=truth,
        fitted=fitted,
        panels=PANELS,
        film=[(shot.t, shot.joined(), _words(shot, errors, of)) for shot in shots],
        heads=[f"t = {shot.t:.2f} s" for shot in chosen],
        rows=[[(shot.panels[k], f"{name} at {shot.t:.2f} s") for shot in chosen] for k, name in enumerate(PANELS)],
        motion=_motion(story, errors),
        course=_course(story),
        settings={
            "gravity": f"{twin.gravity:g} m/s²",
            "floor": f"{1e3 * twin.floor_height:.3f} mm high",
            "time step": f"{1e3 * twin.time_step:.4g} ms",
            "support": twin.support,
            "camera offset": f"{twin.camera_offset[0]:+.3f}, {twin.camera_offset[1]:+.3f} px",
            "surfels": f"{twin.surfels.num_surfels:,}",
        },
        spent=spent,
        provenance=provenance,
    )
    return verdict


def _judge(twin: Twin, shots: list[Shot], errors: PoseErrors | None, history: History | None) -> Verdict:
    """Return the verdict, from the images where they are at hand; ground truth is reported beside it."""
    status, headline = "unknown", "No images at hand: how well the twin reproduces the video is not shown"
    lines = []
    if shots:
        overlap = np.array([shot.overlap for shot in shots])
        status, headline = next(words for least, *words in _GRADES if overlap.mean() >= least)
        worst, colour = int(overlap.argmin()), np.mean([shot.difference for shot in shots])
        lines.append(
            f"Outlines of image and rendering overlap by {100 * overlap.mean():.1f} % on average, "
            f"{100 * overlap[worst]:.1f} % in the worst frame (t = {shots[worst].t:.2f} s); "
            f"colours differ by {100 * colour:.1f} % on average."
        )
    if errors is not None:
        of = "measured poses" if "poses" in twin.provenance else "ground truth, which was never fitted"
        lines.append(f"Against {of}: {errors.words()} ({len(errors.t)} frames).")
    known = [name for name, estimate in twin.theta.items() if estimate.identifiable]
    others = [name for name in twin.theta if name not in known]
    known_words, other_words = (", ".join(names) or "none of the parameters" for names in (known, others))
    lines.append(f"The data determine {known_words}; they do not determine {other_words}.")
    if history is not None and (words := _starts_words(history)):
        lines.append(words)
    # The loss of poses is not that of images.
    if "poses" not in twin.provenance and (doubt := doubt_words(float(twin.provenance.get("loss", 0.0)))):
        lines.append(f"{doubt[0].upper()}{doubt[1:]}.")
    return Verdict(status, headline, lines)


def _starts_words(history: History) -> str:
    """Sentence on how many random starts agree, and on the loss at the end; "" where nothing was evaluated.

    Starts are compared in the first stage, which all of them go through: only the best are refined on larger pictures.
    """
    starts = [rows for _, rows in history.starts()]
    firsts = [history.loss[rows[history.stage[rows] == history.stage[rows[0]]]] for rows in starts]
    bests = np.array([np.min(loss, where=np.isfinite(loss), initial=np.inf) for loss in firsts])
    if not np.isfinite(bests).any():
        return ""
    number, close = len(bests), int((bests <= bests.min() + _CLOSE * abs(bests.min())).sum())
    words = f"Of {number} random starts, {close} agree within {100 * _CLOSE:.0f} %"
    if number == 1:
        words = "There was 1 random start"
    elif close == number:
        words = f"All {number} random starts agree within {100 * _CLOSE:.0f} %"
    end = history.loss[max(starts, key=len)[-1]]
    return f"{words}; the loss at the end is {end:.4g}."


def _draw(story: Story, report: Callable[[float], None]) -> list[Shot]:
    if story.episode is None or story.poses is None:
        return []
    cast = Cast.of(story.twin, 0)
    return draw_shots(story.episode, story.poses, cast, size=_PANEL, most=_MOST_SHOTS, report=report)


def _words(shot: Shot, errors: PoseErrors | None, of: str) -> str:
    words = f"t = {shot.t:.3f} s; outlines overlap by {100 * shot.overlap:.1f} %"
    if errors is None:
        return words
    at = int(np.abs(errors.t - shot.t).argmin())
    if abs(errors.t[at] - shot.t) > 1e-6:
        return words
    millimetres, degrees = 1e3 * errors.position[at], np.degrees(errors.rotation[at])
    return f"{words}; {millimetres:.1f} mm and {degrees:.1f}° from {of}"


def _motion(story: Story, errors: PoseErrors | None) -> dict[str, Figure | None]:
    poses, episode = story.poses, story.episode
    if poses is None:
        return {}
    truth = None if episode is None else episode.object_poses
    pusher = None if episode is None else in_world(story.twin, episode.trajectory)
    mesh, pusher_mesh = load_mesh(story.twin.mesh_path), pusher_surface(story.twin.pusher)
    return {
        "over_time": motion_figure(poses, truth, pusher),
        "from_above": top_figure(mesh, poses, truth, pusher_mesh, pusher),
        "errors": None if errors is None else error_figure(errors),
    }


def _course(story: Story) -> dict[str, Figure | None]:
    history, estimates = story.history, story.twin.theta | story.twin.nuisance
    if history is None or not len(history.iteration):
        return {}
    theta = theta_figure(history, estimates, story.truth) if history.names else None
    return {"loss": loss_figure(history), "theta": theta}
