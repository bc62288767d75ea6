"""The report of a twin: one page that loads nothing from anywhere."""

from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any

from pinwm_drake.capture.pusher import pusher_surface
from pinwm_drake.files import replacing
from pinwm_drake.geometry.meshes import load_mesh
from pinwm_drake.report.embed import figure_uri
from pinwm_drake.report.evaluation.film_strip import player, strips
from pinwm_drake.report.evaluation.pictures import Cast
from pinwm_drake.report.figures.history import loss_figure, theta_figure
from pinwm_drake.report.figures.poses import error_figure, motion_figure, top_figure
from pinwm_drake.report.page import figure, fill_template, paragraph, section, table, text, tree
from pinwm_drake.report.twin.comparison_frames import Shot, draw_shots
from pinwm_drake.report.twin.data import Story
from pinwm_drake.report.twin.estimates_table import estimates_table
from pinwm_drake.report.twin.score import PoseErrors, pose_errors
from pinwm_drake.report.twin.verdict import Verdict, judge

_PANEL, _MOST_SHOTS = 360, 64  # px and frames of the player
_TIMINGS = "timings"


def write_twin_report(path: Path, story: Story, report: Callable[[float], None] = lambda share: None) -> Verdict:
    """Writes the report of a twin.

    Args:
        path: File of the report; its folder exists.
        story: Contents of the report.
        report: Called with the share of the pictures that is done.

    Returns:
        Verdict of the report.

    Raises:
        InputError: An image of the capture cannot be used, or the file cannot be written.
    """
    shots = story.attempt(lambda: _draw(story, report), "So there are no pictures here.") or []
    errors = _errors(story)
    verdict = judge(story.twin, shots, errors, story.history)
    parts = {
        "title": text(f"Twin of {story.twin.name}"),
        "about": _about(story),
        "notices": "\n".join(f'<p class="notice"><b>Note:</b> {text(notice)}</p>' for notice in story.notices),
        "body": "\n".join((_verdict(verdict), *_sections(story, shots, errors))),
    }
    with replacing(path) as temporary:
        temporary.write_text(fill_template(parts), encoding="utf-8")
    return verdict


def _draw(story: Story, report: Callable[[float], None]) -> list[Shot]:
    """The frames of the identified episode; none where it is not at hand."""
    if story.episode is None or story.poses is None:
        return []
    cast = Cast.of(story.twin, 0)
    return draw_shots(story.episode, story.poses, cast, size=_PANEL, most=_MOST_SHOTS, report=report)


def _errors(story: Story) -> PoseErrors | None:
    truth = None if story.episode is None else story.episode.object_poses
    return None if truth is None or story.poses is None else pose_errors(story.poses, truth)


def _about(story: Story) -> str:
    if story.origin is None:
        return "The twin does not say what it was identified from."
    names = story.origin.episodes
    word = "episode" if len(names) == 1 else "episodes"
    return f"Identified from {word} {text(', '.join(names))} of {text(story.origin.path)}"


def _verdict(verdict: Verdict) -> str:
    lines = "".join(f"<li>{text(line)}</li>" for line in verdict.lines)
    return f'<div class="verdict {verdict.status}"><p>{text(verdict.headline)}</p><ul>{lines}</ul></div>'


def _sections(story: Story, shots: list[Shot], errors: PoseErrors | None) -> list[str]:
    return [
        _parameters(story),
        section("The episode as the camera saw it and as the twin shows it", *_episode(shots, errors)),
        section("Motion", *_motion(story, errors)),
        section("Course of the identification", *_course(story)),
        _timings(story.twin.provenance.get(_TIMINGS)),
        section("Provenance", tree({key: value for key, value in story.twin.provenance.items() if key != _TIMINGS})),
    ]


def _parameters(story: Story) -> str:
    twin, contents = story.twin, [estimates_table(story.twin.theta, story.truth)]
    contents.append(
        paragraph(
            "A parameter that is not identifiable has hardly any influence on these images: its value is what it was "
            "at the start or what the capture says."
        )
    )
    if twin.nuisance:
        contents.append("<h3>Nuisances</h3>" + estimates_table(twin.nuisance, {}))
    physics = {
        "gravity": f"{twin.gravity:g} m/s²",
        "floor": f"{1e3 * twin.floor_height:.3f} mm high",
        "time step": f"{1e3 * twin.time_step:.4g} ms",
        "support": twin.support,
        "camera offset": f"{twin.camera_offset[0]:+.3f}, {twin.camera_offset[1]:+.3f} px",
        "surfels": f"{twin.surfels.num_surfels:,}",
    }
    return section("Physical parameters", *contents, "<h3>Settings</h3>" + tree(physics))


def _episode(shots: list[Shot], errors: PoseErrors | None) -> list[str]:
    if not shots:
        return []
    return [
        player(shots, errors),
        strips(shots),
        paragraph(
            "The difference is white where both agree, and light blue where the pusher hides what is behind it; those "
            "pixels do not count."
        ),
    ]


def _motion(story: Story, errors: PoseErrors | None) -> list[str]:
    poses, episode = story.poses, story.episode
    if poses is None:
        return []
    truth, pusher = (episode.object_poses, episode.trajectory) if episode is not None else (None, None)
    meshes = load_mesh(story.twin.mesh_path), pusher_surface(story.twin.pusher)
    scored = " Ground truth was scored, never fitted." if truth is not None else ""
    contents = [
        figure(figure_uri(motion_figure(poses, truth, pusher)), f"Origin and yaw of the object over time.{scored}"),
        figure(
            figure_uri(top_figure(meshes[0], poses, truth, meshes[1], pusher)),
            f"From above at equal times, dark at the end.{scored}",
            narrow=True,
        ),
    ]
    if errors is not None:
        contents.append(figure(figure_uri(error_figure(errors)), "Distance from ground truth, over time."))
    return contents


def _course(story: Story) -> list[str]:
    history = story.history
    if history is None or not len(history.iteration):
        return []
    estimates = story.twin.theta | story.twin.nuisance
    contents = [
        figure(figure_uri(loss_figure(history)), "Loss of each random start; stages begin at the dotted lines.")
    ]
    if history.names:
        units = {name: estimate.unit for name, estimate in estimates.items()}
        words = "Fitted parameters; the twin's value is dash-dotted, with its 95 % interval where the data determine it"
        words += ", and the ground truth is dotted." if story.truth else "."
        contents.append(figure(figure_uri(theta_figure(history, estimates, story.truth, units)), words))
    return contents


def _timings(timings: Any) -> str:
    """A table of seconds with bars; a tree where they are something else."""
    if not isinstance(timings, Mapping) or not timings:
        return section("Timings", "" if timings is None else tree(timings))
    if not all(isinstance(value, (int, float)) and value >= 0 for value in timings.values()):
        return section("Timings", tree(timings))
    longest = max(*timings.values(), 1e-9)
    rows = [
        (text(name), f"{value:.2f} s", f'<span class="bar" style="width: {100 * value / longest:.1f}%"></span>')
        for name, value in timings.items()
    ]
    return section("Timings", table([("part", "key"), ("time", "number"), ("", "wide")], rows))
