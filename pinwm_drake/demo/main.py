# SPDX-License-Identifier: MIT
"""The main demonstration: from the images of a push to a twin, to another push predicted, to a policy that acts."""

from pathlib import Path

from rich.console import Console

from pinwm_drake.capture.check import check_capture
from pinwm_drake.capture.episodes import Episode, ObjectPoses, read_episode
from pinwm_drake.capture.scene import Capture, load_capture
from pinwm_drake.capture.write import write_pose_table
from pinwm_drake.demo.kernels import compiling
from pinwm_drake.demo.options import DemoOptions
from pinwm_drake.demo.page import PAGE_FILE, DemoPush, DemoResult, write_films, write_page
from pinwm_drake.demo.policy import run_policy
from pinwm_drake.demo.stages import Report, Stages
from pinwm_drake.errors import InputError
from pinwm_drake.experiments.alignment import align, read_source
from pinwm_drake.experiments.twins import identify
from pinwm_drake.files import prepare_folder
from pinwm_drake.kernel_cache import COMPILING
from pinwm_drake.report.twin.comparison_frames import Cast, draw_shots
from pinwm_drake.report.twin.data import read_story
from pinwm_drake.report.twin.report import write_twin_report
from pinwm_drake.report.twin.score import pose_errors
from pinwm_drake.twin.predict import predict_poses
from pinwm_drake.twin.twin import Twin

_TWIN, _PREDICTION = "twin", "prediction"  # folders of the results
_PANEL = 480  # px, at most, of the films of a push


def run_demo(out: Path, options: DemoOptions | None = None) -> None:
    """Run all stages and write their files, the page last. Files of an earlier run are replaced.

    Without options, capture and policy are those that ship.

    Raises:
        PinwmError: An input was refused, the physics found no solution, or a file cannot be written.
        SystemExit: With 1, when the user interrupts (Ctrl-C).
    """
    stages = Stages(Console())
    prepare_folder(out)
    # A page tells of the run that wrote it; a run that is cut short leaves none.
    (out / PAGE_FILE).unlink(missing_ok=True)
    try:
        _run(out, options or DemoOptions(), stages)
    except KeyboardInterrupt:
        stages.say("interrupted")
        raise SystemExit(1) from None


def _run(out: Path, options: DemoOptions, stages: Stages) -> None:
    with stages.stage("check the capture"):
        capture, episodes = _read(options.capture)
    with compiling(options.capture, options.identify) as wait:
        with stages.stage("align") as report:
            report(0.0, "getting ready")
            parts = {"fitting": _part(report, 0.0, 0.9), "drawing": _part(report, 0.9, 1.0)}
            fitted = align(
                options.capture,
                out / _TWIN,
                options=options.fit,
                progress=lambda name, share, words: parts[name](share, words),
            )
        # Before the twin is there: it needs nothing of it, and the compiler may still be at work.
        with stages.stage("policy, hydroelastic"):
            in_plant = run_policy(options, options.scene, "hydroelastic")
        with stages.stage("wait for the compiler") as report:
            report(0.0, COMPILING)
            compiled = wait()
    if compiled is not None:
        stages.costs.append(compiled)
    with stages.stage("identify") as report:
        found = identify(
            options.capture,
            out / _TWIN,
            options=options.identify,
            progress=lambda _, share, words: report(share, words),
        )
        twin = found.twin
    with stages.stage("report") as report:
        story = read_story(out / _TWIN)
        write_twin_report(out / _TWIN / "report.html", story, lambda share: report(share, ""))
    with stages.stage("predict") as report:
        predicted = predict_poses(twin, capture, episodes[1], None)
        prepare_folder(out / _PREDICTION)
        write_pose_table(out / _PREDICTION / f"{episodes[1].name}.csv", predicted)
        pushes = (
            _compare(twin, episodes[0], found.poses[0], 0, _part(report, 0.0, 0.5)),
            _compare(twin, episodes[1], predicted, None, _part(report, 0.5, 1.0)),
        )
    with stages.stage("policy, twin"):
        performances = [run_policy(options, str(out / _TWIN), "twin"), in_plant]
    with stages.stage("films") as report:
        films = write_films(out, pushes, performances, report)
    result = DemoResult(
        options=options,
        views=read_source(options.capture, None).views,
        fit=fitted,
        twin=twin,
        truth=story.truth,
        identified=pushes[0],
        predicted=pushes[1],
        performances=performances,
        stages=stages,
    )
    write_page(out, result, films)
    _conclude(out, result)


def _read(folder: Path) -> tuple[Capture, list[Episode]]:
    """Return the capture and its first two episodes; raises InputError where `pinwm capture check` finds an error."""
    check = check_capture(folder)
    for problem in check.problems:
        if problem.severity == "error":
            error = problem.problem
            raise InputError(folder / error.path, allowed=error.allowed, row=error.row, value=error.value)
    capture = load_capture(folder)
    if len(capture.episode_names) < 2:
        raise InputError(folder, value=f"{len(capture.episode_names)} episodes", allowed="a capture with two or more")
    return capture, [read_episode(capture, name) for name in capture.episode_names[:2]]


def _part(report: Report, low: float, high: float) -> Report:
    """Progress of a part of a stage, from a share of the stage to another one."""
    return lambda share, words: report(low + (high - low) * share, words)


def _compare(twin: Twin, episode: Episode, poses: ObjectPoses, push: int | None, report: Report) -> DemoPush:
    cast, truth, words = Cast.of(twin, push), episode.object_poses, f"episode {episode.name}"
    number = len(episode.t)
    shots = draw_shots(episode, poses, cast, size=_PANEL, most=number, report=lambda share: report(share, words))
    return DemoPush(episode.name, shots, None if truth is None else pose_errors(poses, truth))


def _conclude(out: Path, result: DemoResult) -> None:
    stages = result.stages
    friction = result.twin.theta["friction_floor"]
    interval = "" if friction.interval is None else " ({:.4f} to {:.4f})".format(*friction.interval)
    truth = "" if "friction_floor" not in result.truth else f"; true: {result.truth['friction_floor']:.4f}"
    stages.say(f"friction of the floor: {friction.value:.4f}{interval}{truth}")
    if result.predicted.errors is not None:
        stages.say(f"episode {result.predicted.name}, predicted: {result.predicted.errors.words()}")
    for one in result.performances:
        ended = one.record.result
        outcome = f"{ended.outcome} after {ended.steps} actions, {1e3 * ended.distance:.1f} mm from the goal"
        stages.say(f"policy, {one.engine}: {outcome}")
    stages.say(f"wrote {out / PAGE_FILE} after {stages.seconds:.0f} s")
