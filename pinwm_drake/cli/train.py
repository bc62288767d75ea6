"""`pinwm train`: options, a bar for each stage of the training, and the files that it leaves."""

import math
import time
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer
from rich.console import Console

from pinwm_drake.cli.console import duration, progress_bar, say

if TYPE_CHECKING:
    from pinwm_drake.learning.progress import Report, Step


_LINES_PERIOD = 10.0  # s


def train(
    scene: Annotated[
        str, typer.Argument(metavar="TWIN", help="Folder that `pinwm identify` wrote, or a scenario such as push_t.")
    ],
    out: Annotated[Path, typer.Option("--out", "-o", help="Folder of the run; the policy is there at the end.")],
    in_scene: Annotated[
        str | None,
        typer.Option(
            "--scene",
            help="Scenario in which the twin takes the place of the object.",
            show_default="that of the twin's capture for push, else that of --task",
        ),
    ] = None,
    task: Annotated[str | None, typer.Option(help="Task to learn: push or flip.", show_default="the scene's")] = None,
    method: Annotated[
        str,
        typer.Option(
            help="distil: a teacher that sees the state, and a student of images that learns from it; "
            "ppo: from images at once; state: the teacher alone."
        ),
    ] = "distil",
    algorithm: Annotated[
        str | None,
        typer.Option(
            help="That the policy of the state learns with: sac or ppo.", show_default="sac for push, ppo for flip"
        ),
    ] = None,
    delta: Annotated[float, typer.Option(help="Of the cousins; 0 trains in the twin alone.")] = 0.1,
    from_intervals: Annotated[
        bool,
        typer.Option("--from-intervals", help="Draw what was identified from the twin's posterior."),
    ] = False,
    yaw: Annotated[
        float | None, typer.Option(help="rad, by which the object is turned at the start, at most.", show_default="π/2")
    ] = None,
    tolerance: Annotated[
        float | None, typer.Option(help="m, from the goal, for success.", show_default="the task's")
    ] = None,
    turn_tolerance: Annotated[
        float | None, typer.Option(help="rad, from the goal's, for success.", show_default="the task's")
    ] = None,
    latency: Annotated[
        tuple[float, float],
        typer.Option(help="s, least and most after which actions take effect; drawn for each episode."),
    ] = (0.0, 0.0),
    as_filmed: Annotated[
        bool,
        typer.Option(
            "--as-filmed",
            help="The camera is that which filmed the push, and is off by as much as the twin says (view_x to _z).",
        ),
    ] = False,
    goals: Annotated[
        str, typer.Option(help="fixed, or random: each episode draws its goal, and the policy is told which.")
    ] = "fixed",
    goal_reach: Annotated[float, typer.Option(help="m, along x and y, from the task's own goal to random ones.")] = 0.1,
    goal_turn: Annotated[
        float, typer.Option(help="rad, from the task's own goal to random ones.", show_default="π")
    ] = math.pi,
    seed: Annotated[int, typer.Option(help="Of networks, worlds and cousins.")] = 0,
    worlds: Annotated[int, typer.Option(help="That are trained in at once.")] = 64,
    image_size: Annotated[int, typer.Option(help="px.")] = 64,
    frames: Annotated[int, typer.Option(help="Images that the policy sees, one an action.")] = 3,
    history: Annotated[
        int,
        typer.Option(
            help="Last actions that teacher and student see, each with what was before it. More than 0: no bundle."
        ),
    ] = 0,
    max_translation: Annotated[
        float | None, typer.Option(help="m, of the pusher in an action of 0.1 s.", show_default="the task's")
    ] = None,
    steps: Annotated[
        int | None, typer.Option(help="Of SAC or PPO, all worlds together.", show_default="as the method needs")
    ] = None,
    round_steps: Annotated[
        int | None, typer.Option(help="Of SAC or PPO between two evaluations.", show_default="as the method needs")
    ] = None,
    rounds: Annotated[int | None, typer.Option(help="Of the distillation.", show_default="as needed")] = None,
    images: Annotated[
        int | None, typer.Option(help="That a round of the distillation collects.", show_default="as needed")
    ] = None,
    updates: Annotated[
        int | None, typer.Option(help="Of the student in a round of the distillation.", show_default="as needed")
    ] = None,
    episodes: Annotated[
        int | None, typer.Option(help="Of each evaluation, after every round.", show_default="as the method needs")
    ] = None,
    shift: Annotated[int | None, typer.Option(help="px, random shift of the student's images.")] = None,
    mask_error: Annotated[
        float,
        typer.Option(
            help="px, by which outlines that the student learns from are too small or too large at most, up to 1."
        ),
    ] = 0.0,
    auxiliary: Annotated[
        bool,
        typer.Option(
            "--auxiliary/--no-auxiliary",
            help="Of ppo: learn from the worlds' states to estimate them from images, or by reward alone.",
        ),
    ] = True,
    teacher: Annotated[
        Path | None, typer.Option(help="A policy of the state to learn from, instead of training one.")
    ] = None,
    target: Annotated[
        float | None, typer.Option(help="Success rate of an evaluation at which a stage is over, up to 1.")
    ] = None,
    minutes: Annotated[
        float | None,
        typer.Option(
            help="After which no round begins; one of each stage is done in any case. The best policy so far comes out."
        ),
    ] = None,
    threads: Annotated[int | None, typer.Option(help="Of torch.", show_default="one on each core")] = None,
    device: Annotated[str, typer.Option(help="Of the networks: cpu, or cuda where there is one.")] = "cpu",
    resume: Annotated[bool, typer.Option("--resume", help="Go on where an interrupted run ended.")] = False,
) -> None:
    """Trains a policy in cousins of a twin, with progress, checkpoints and TensorBoard."""
    from pinwm_drake.experiments import training
    from pinwm_drake.experiments.forecast import forecast
    from pinwm_drake.learning.policy import POLICY_FILE

    request = training.TrainRequest(
        scene=scene,
        out=out,
        in_scene=in_scene,
        task=task,
        method=method,
        algorithm=algorithm,
        delta=delta,
        from_intervals=from_intervals,
        yaw=yaw,
        tolerance=tolerance,
        turn_tolerance=turn_tolerance,
        latency=latency,
        as_filmed=as_filmed,
        goals=goals,
        goal_reach=goal_reach,
        goal_turn=goal_turn,
        seed=seed,
        worlds=worlds,
        image_size=image_size,
        frames=frames,
        history=history,
        max_translation=max_translation,
        steps=steps,
        round_steps=round_steps,
        rounds=rounds,
        images=images,
        updates=updates,
        episodes=episodes,
        shift=shift,
        mask_error=mask_error,
        auxiliary=auxiliary,
        teacher=teacher,
        target=target,
        minutes=minutes,
        threads=threads,
        device=device,
        resume=resume,
    )
    begun = time.monotonic()
    try:
        training.check_new(request)
        if not resume:
            say(f"this takes {forecast(request)} here; most end before")
        with _shown() as report:
            training.train(request, report=report)
    except KeyboardInterrupt:
        say(f"interrupted; go on with --resume (what is done is in {out})")
        raise SystemExit(1) from None
    took = (time.monotonic() - begun) / 60
    say(f"trained for {took:.1f} minutes in this run; wrote {out / training.FIGURE_FILE}")
    say(f"wrote {out / POLICY_FILE}; try it with: pinwm evaluate {out} --engine hydroelastic")


@contextmanager
def _shown() -> Iterator["Report"]:
    """Shows the progress of a training: a bar for each stage on a terminal, otherwise a line now and then."""
    if not Console().is_terminal:
        yield _Lines()
        return
    with progress_bar("{task.percentage:.0f} %  {task.fields[figures]}", left="{task.fields[left]} left") as bar:
        tasks = {}

        def report(step: "Step") -> None:
            figures, left = _figures(step), duration(step.left)
            if step.stage not in tasks:
                tasks[step.stage] = bar.add_task(step.stage, total=1.0, figures=figures, left=left)
            bar.update(tasks[step.stage], completed=step.done, figures=figures, left=left)

        yield report


class _Lines:
    """Printer of lines on a training: at the beginning and the end of a round, and between every 10 s at most."""

    def __init__(self) -> None:
        self._last, self._evaluation = -math.inf, ""

    def __call__(self, step: "Step") -> None:
        """Prints a line on the progress where one is due."""
        now, evaluation = time.monotonic(), f"{step.stage} {step.success} {step.length}"
        # A round has ended where its evaluation is another one.
        if evaluation == self._evaluation and step.done < 1.0 and now - self._last < _LINES_PERIOD:
            return
        self._last, self._evaluation = now, evaluation
        say(f"{step.stage} {step.done:4.0%}  {_figures(step)}  {duration(step.left)} left")


def _figures(step: "Step") -> str:
    """Text of the numbers of a training that are known."""
    if step.stage == "waypoints":
        return f"{step.steps} states of plans, of which the best did the task in {step.best:.0%} of its replays"
    if not step.steps:
        return "getting ready (the first run compiles for minutes)"
    words = [f"{step.steps:,} steps"]
    words += [] if math.isnan(step.rate) else [f"{step.rate:.0f} steps/s"]
    words += [] if math.isnan(step.loss) else [f"loss {step.loss:.4f}"]
    words += [] if math.isnan(step.recent) else [f"success in training {step.recent:.0%}"]
    if not math.isnan(step.success):
        words.append(f"success {step.success:.0%} in {step.length:.0f} actions, best {step.best:.0%}")
    return "  ".join(words)
