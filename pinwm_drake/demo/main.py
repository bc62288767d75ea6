"""The main demonstration: from the images of a push to a twin, to another push predicted, to a policy that acts."""

from functools import partial
from pathlib import Path

from rich.console import Console

from pinwm_drake.capture.check import check_capture
from pinwm_drake.capture.episodes import Episode, ObjectPoses, read_episode
from pinwm_drake.capture.scene import Capture, read_capture
from pinwm_drake.capture.write import write_pose_table
from pinwm_drake.demo.films import write_films
from pinwm_drake.demo.kernels import KernelsAhead
from pinwm_drake.demo.options import DemoOptions
from pinwm_drake.demo.page import PAGE_FILE, write_page
from pinwm_drake.demo.policy import Performance, run_policy
from pinwm_drake.demo.result import DemoPush, DemoResult
from pinwm_drake.demo.stages import Report, Stages
from pinwm_drake.errors import InputError
from pinwm_drake.experiments.alignment import align, read_source
from pinwm_drake.experiments.twins import twin_from_capture
from pinwm_drake.files import prepare_folder
from pinwm_drake.rendering.fitting import FitResult
from pinwm_drake.rendering.views import View
from pinwm_drake.report.evaluation.pictures import Cast
from pinwm_drake.report.twin.comparison_frames import draw_shots
from pinwm_drake.report.twin.data import read_story
from pinwm_drake.report.twin.report import write_twin_report
from pinwm_drake.report.twin.score import pose_errors
from pinwm_drake.twin.predict import predict_poses
from pinwm_drake.twin.twin import Twin

_TWIN, _PREDICTION = "twin", "prediction"  # folders of the results
_PANEL = 480  # px, at most, of the films of a push


def run_demo(out: Path, options: DemoOptions | None = None) -> None:
    """Runs all stages and writes their files, the page last. Files of an earlier run are replaced.

    Args:
        out: Folder of the results; made if need be.
        options: None for the capture and the policy that ship.

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
    """All stages, one after the other."""
    with stages.stage("check the capture"):
        capture, episodes = _read(options.capture)
    with KernelsAhead(options.capture, options.identify) as ahead:
        with stages.stage("align") as report:
            views, surfels = _align(out, options, report)
        # Before the twin is there: it needs nothing of it, and the compiler may still be at work.
        with stages.stage("policy, hydroelastic"):
            in_plant = _act(options.scene, "hydroelastic", options)
        with stages.stage("wait for the compiler") as report:
            report(0.0, "the first run compiles the physics, which takes minutes")
            compiled = ahead.wait()
    if compiled is not None:
        stages.costs.append(compiled)
    with stages.stage("identify") as report:
        twin, poses = _identify(out, options, report)
    with stages.stage("report") as report:
        story = read_story(out / _TWIN)
        write_twin_report(out / _TWIN / "report.html", story, lambda share: report(share, ""))
    with stages.stage("predict") as report:
        predicted = predict_poses(twin, capture, episodes[1], None)
        prepare_folder(out / _PREDICTION)
        write_pose_table(out / _PREDICTION / f"{episodes[1].name}.csv", predicted)
        pushes = (
            _compare(twin, episodes[0], poses, 0, lambda share, words: report(0.5 * share, words)),
            _compare(twin, episodes[1], predicted, None, lambda share, words: report(0.5 + 0.5 * share, words)),
        )
    with stages.stage("policy, twin"):
        performances = [_act(str(out / _TWIN), "twin", options), in_plant]
    with stages.stage("films") as report:
        films = write_films(out, pushes, performances, report)
    result = DemoResult(
        options=options,
        capture=capture,
        views=views,
        fit=surfels,
        twin=twin,
        truth=story.truth,
        identified=pushes[0],
        predicted=pushes[1],
        performances=performances,
        costs=stages.costs,
        seconds=stages.seconds,
    )
    write_page(out, result, films)
    _conclude(out, result, stages)


def _read(folder: Path) -> tuple[Capture, list[Episode]]:
    """The capture and its first two episodes; raises InputError where `pinwm capture check` finds an error."""
    check = check_capture(folder)
    for problem in check.problems:
        if problem.severity == "error":
            raise problem.problem
    capture = read_capture(folder)
    if len(capture.episode_names) < 2:
        raise InputError(folder, value=f"{len(capture.episode_names)} episodes", allowed="a capture with two or more")
    return capture, [read_episode(capture, name) for name in capture.episode_names[:2]]


def _align(out: Path, options: DemoOptions, report: Report) -> tuple[list[View], FitResult]:
    """The static views, and the surfels that are fitted to them."""
    report(0.0, "getting ready (the first run compiles the renderer)")
    told = partial(_tell, report, {"fitting": (0.0, 0.9), "drawing": (0.9, 1.0)})
    result = align(options.capture, out / _TWIN, options=options.fit, progress=told)
    return read_source(options.capture, None).views, result


def _identify(out: Path, options: DemoOptions, report: Report) -> tuple[Twin, ObjectPoses]:
    """The twin, written to its folder beside the surfels, and its poses at the frames of the first episode."""
    told = partial(_tell, report, {"identifying": (0.0, 1.0)})
    found = twin_from_capture(options.capture, out / _TWIN, options=options.identify, progress=told)
    return found.twin, found.poses[0]


def _tell(report: Report, parts: dict[str, tuple[float, float]], stage: str, done: float, words: str) -> None:
    """Progress of a library call as a part of the progress of a stage."""
    low, high = parts[stage]
    report(low + (high - low) * done, words)


def _compare(twin: Twin, episode: Episode, poses: ObjectPoses, push: int | None, report: Report) -> DemoPush:
    """A push with its frames and, where the truth is known, its errors."""
    cast, truth = Cast.of(twin, push), episode.object_poses
    number = len(episode.t)
    shots = draw_shots(
        episode, poses, cast, size=_PANEL, most=number, report=lambda share: report(share, f"episode {episode.name}")
    )
    return DemoPush(episode.name, poses, shots, None if truth is None else pose_errors(poses, truth))


def _act(scene: str, engine: str, options: DemoOptions) -> Performance:
    """The policy's episode in a scene."""
    return run_policy(options.policy, scene, engine, seed=options.seed, max_steps=options.max_steps)


def _conclude(out: Path, result: DemoResult, stages: Stages) -> None:
    """The result in a few lines."""
    friction = result.twin.theta["friction_floor"]
    interval = "" if friction.interval is None else " ({:.4f} to {:.4f})".format(*friction.interval)
    truth = "" if "friction_floor" not in result.truth else f"; true: {result.truth['friction_floor']:.4f}"
    stages.say(f"friction of the floor: {friction.value:.4f}{interval}{truth}")
    if result.predicted.errors is not None:
        stages.say(f"episode {result.predicted.name}, predicted: {result.predicted.errors.words()}")
    for performance in result.performances:
        stages.say(f"policy, {performance.engine}: {_outcome(performance)}")
    stages.say(f"wrote {out / PAGE_FILE} after {stages.seconds:.0f} s")


def _outcome(performance: Performance) -> str:
    outcome = performance.record.result
    return f"{outcome.outcome} after {outcome.steps} actions, {1e3 * outcome.distance:.1f} mm from the goal"
