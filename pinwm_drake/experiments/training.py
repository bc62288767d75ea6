# SPDX-License-Identifier: MIT
"""The training of a policy of a task in the cousins of a twin, in one or two stages, with all files that it leaves."""

import math
import time
from dataclasses import replace
from pathlib import Path
from typing import Any

import torch

from pinwm_drake.cousins.domain import CousinDomains, DomainSource, known_ranges
from pinwm_drake.errors import InputError, require
from pinwm_drake.experiments.requests.train import TrainRequest
from pinwm_drake.files import occupying, prepare_folder
from pinwm_drake.learning.distil import DistilOptions
from pinwm_drake.learning.export import check_exportable
from pinwm_drake.learning.method import Method, MethodData
from pinwm_drake.learning.pin_wm import STAGES, Distillation, ImagePpo, StatePpo, StateSac, read_teacher
from pinwm_drake.learning.policy import Policy, write_policy
from pinwm_drake.learning.ppo import PpoOptions
from pinwm_drake.learning.progress import Report, silent
from pinwm_drake.learning.rounds import ANY, CHECKPOINT_FILE, HISTORY_FILE, ROUND_FILE
from pinwm_drake.learning.sac import SacOptions
from pinwm_drake.learning.weights import devices
from pinwm_drake.provenance import timestamp, versions
from pinwm_drake.report.figures.training import training_figure
from pinwm_drake.station.document import load_station
from pinwm_drake.systems.envs.policy_scene import scene_record
from pinwm_drake.systems.envs.training_worlds import TrainingWorlds, training_options
from pinwm_drake.systems.mpc.waypoints import STAGE as WAYPOINTS
from pinwm_drake.systems.mpc.waypoints import WaypointOptions, find_waypoints
from pinwm_drake.systems.scenario.at_station import at_station, latency_of
from pinwm_drake.systems.scenario.load import load_setup
from pinwm_drake.systems.scenario.setup import Setup
from pinwm_drake.tasks import DEFAULT_TASK
from pinwm_drake.tasks.recipe import Recipe
from pinwm_drake.tasks.registry import changed_task, recipe_of
from pinwm_drake.tasks.task import Task
from pinwm_drake.tasks.waypoints import WAYPOINTS_FILE
from pinwm_drake.twin.twin import Twin

FIGURE_FILE = "training.png"


def train(
    request: TrainRequest,
    *,
    domains: DomainSource | None = None,
    search: WaypointOptions | None = None,
    report: Report = silent,
) -> Policy:
    """Trains a policy and writes it to `request.out`, with checkpoints, `training.png` and each stage's history.

    A run that was interrupted or killed goes on with `request.resume`.

    Args:
        request: The training.
        domains: Distribution of the episodes' domains; None for cousins, as the request has them.
        search: Settings of the search for waypoints, where the task has them; None for the defaults.
        report: Called with the progress of the training.

    Returns:
        The best policy, with its provenance.

    Raises:
        PinwmError: An option is out of range, the scene cannot be read, or a file cannot be written.
    """
    with occupying(request.out) as out:
        stages = [out / stage for stage in STAGES]
        check_new(request)
        if request.threads is not None:
            torch.set_num_threads(request.threads)
        begun, worlds = time.monotonic(), worlds_of(request, domains)
        if request.method != "state" and not request.resume:
            spec = worlds.spec("rgb")
            if request.teacher is not None:
                read_teacher(request.teacher, spec.history)
            check_exportable(spec)
        if _searches(request, worlds.setup.task):
            folder = prepare_folder(out / WAYPOINTS)
            worlds.waypoints = find_waypoints(
                worlds, folder, search, seed=request.seed, resume=request.resume, report=report
            )
        method = method_of(request, worlds.setup.task, (time.monotonic() - begun) / 60.0)
        policy = method.train(MethodData(), worlds, out, seed=request.seed, resume=request.resume, report=report)
        assert isinstance(policy, Policy)
        histories = {stage.name: stage / HISTORY_FILE for stage in stages if (stage / HISTORY_FILE).exists()}
        training_figure(out / FIGURE_FILE, histories)
        policy = replace(policy, provenance=_provenance(request, worlds))
        write_policy(out, policy)
        return policy


def check_new(request: TrainRequest) -> None:
    """Raise InputError where the folder of a request that is not to go on holds a training."""
    if not request.resume and any((request.out / stage / CHECKPOINT_FILE).exists() for stage in STAGES):
        raise InputError(request.out, value="a training that was begun", allowed="a new folder, or --resume to go on")


def searches(request: TrainRequest) -> bool:
    """Flag: a training begins with a search for waypoints; raises InputError where its scene cannot be used."""
    return _searches(request, request.task or _setup(request).task)


def _searches(request: TrainRequest, task: Task | str) -> bool:
    return recipe_of(task).waypoints and request.teacher is None


def can_go_on(out: Path) -> bool:
    """Flag: a folder holds something that a training goes on from with `resume`."""
    files = [out / stage / name for stage in STAGES for name in (CHECKPOINT_FILE, ROUND_FILE)]
    return any(path.is_file() for path in [*files, out / WAYPOINTS / WAYPOINTS_FILE])


def _provenance(request: TrainRequest, worlds: TrainingWorlds) -> dict[str, Any]:
    return {
        "task": worlds.setup.task.name,
        "method": request.method,
        "algorithm": "ppo" if request.method == "ppo" else request.algorithm or recipe_of(worlds.setup.task).algorithm,
        **({"auxiliary": request.auxiliary} if request.method == "ppo" else {}),
        "trained_in": worlds.about,
        "home": scene_record(request.scene, _placed_in(request), request.station),
        "seed": request.seed,
        "worlds": request.worlds,
        "time": timestamp(),
        "versions": versions(),
    }


def worlds_of(request: TrainRequest, domains: DomainSource | None = None) -> TrainingWorlds:
    """Return the worlds of a request; `domains` as for `train`."""
    setup, station = _setup(request), None if request.station is None else load_station(request.station)
    changes = {name: getattr(request, name) for name in ("tolerance", "turn_tolerance")}
    given: dict[str, Any] = {name: value for name, value in changes.items() if value is not None}
    if request.goals == "random":
        given["goal_range"] = (request.goal_reach, request.goal_reach, request.goal_turn)
    task: dict[str, Any] | None = given if request.task is None else {"name": request.task} | given
    recipe = recipe_of(request.task or setup.task)
    history = request.history
    if history is None:
        history = 0 if request.method == "ppo" else recipe.history
    # A stack of large images costs too much, and a student that sees images one by one keeps parts of them.
    size = request.image_size or (recipe.image_size if history else Recipe.image_size)
    latency = request.latency or recipe.latency
    if station is not None:
        setup = at_station(replace(setup, task=changed_task(setup.task, task)), station)
        task, size, latency = None, setup.camera.width, request.latency or latency_of(station.document)
    options = training_options(
        task=task,
        image_size=size,
        frames=max(request.frames, history + 1),
        history=history,
        max_translation=request.max_translation,
        latency=latency,
        lag=request.lag,
        acceleration=math.inf if request.acceleration is None else request.acceleration,
        view=_view(setup.twin) if request.as_filmed else (0.0, 0.0, 0.0),
    )
    domains = domains or _cousins(request, setup.twin, recipe.spread)
    return TrainingWorlds(setup, options, num_worlds=request.worlds, domains=domains, yaw=request.yaw)


def _cousins(request: TrainRequest, twin: Twin, spread: tuple[float, float] | None = None) -> CousinDomains:
    frictions, known = (request.friction_floor, request.friction_pusher), request.from_intervals or not request.delta
    spread = None if known else spread
    domains = CousinDomains(request.delta, request.from_intervals, request.seed, *frictions, widen=True, spread=spread)
    return domains if domains.wide(twin) else replace(domains, widen=False)


def wide_frictions(request: TrainRequest) -> dict[str, tuple[float, float]]:
    """Identified intervals of frictions, by name, that are so wide that episodes draw them from the posterior.

    Raises:
        InputError: The scene of the request cannot be used.
    """
    twin = _setup(request).twin
    return _cousins(request, twin).wide(twin)


def doubts(request: TrainRequest) -> list[str]:
    """Sentences on frictions of a training with which its task is not known to be possible.

    Raises:
        InputError: The scene of the request cannot be used.
    """
    setup = _setup(request)
    asked = {"friction_floor": request.friction_floor, "friction_pusher": request.friction_pusher}
    ranges = known_ranges(setup.twin) | {name: ends for name, ends in asked.items() if ends is not None}
    return recipe_of(request.task or setup.task).doubts(ranges)


def _placed_in(request: TrainRequest) -> str | None:
    """Return the scenario that a twin stands in: the one that is named, or that of the task; None for its own."""
    task, where = request.task or DEFAULT_TASK, request.in_scene
    if where is None and Path(request.scene).is_dir() and recipe_of(task).scene != recipe_of(DEFAULT_TASK).scene:
        where = recipe_of(task).scene
    return where


def _setup(request: TrainRequest) -> Setup:
    where = _placed_in(request)
    return load_setup(request.scene) if where is None else load_setup(where, twin=request.scene)


def _view(twin: Twin) -> tuple[float, float, float]:
    """Way (3,) m, world, by which the camera of a twin's push shows the object beside where it is.

    Raises:
        ParameterError: The twin is not one that was identified from one push; each of several has a way of its own.
    """
    names = [f"view_{axis}" for axis in "xyz"]
    known = all(name in twin.nuisance for name in names)
    without = f"twin {twin.name} without {', '.join(names)}"
    require("--as-filmed", without, known, "a twin that `pinwm identify` made from one push")
    x, y, z = (twin.nuisance[name].value for name in names)
    return x, y, z


def method_of(request: TrainRequest, task: Task, spent: float = 0.0) -> Method:
    """Return the method of a request, with the settings that are given, of whose minutes some are spent."""
    left = None if request.minutes is None else max(request.minutes - spent, 0.01)
    until = _with(ANY, target=request.target, minutes=left)
    steps = {"steps": request.steps, "round_steps": request.round_steps, "episodes": request.episodes}
    if request.method == "ppo":
        options = PpoOptions.for_images(auxiliary=request.auxiliary)
        return ImagePpo(_with(options, **steps, shift=request.shift), until, request.device)
    algorithm = request.algorithm or recipe_of(task).algorithm
    teacher = StateSac(_with(SacOptions(), **steps)) if algorithm == "sac" else StatePpo(_with(PpoOptions(), **steps))
    if request.method == "state":
        return replace(teacher, until=until, device=request.device)
    options = _with(
        DistilOptions() if left is None else DistilOptions.within_minutes(),
        rounds=request.rounds,
        round_images=request.images,
        updates=request.updates,
        episodes=request.episodes,
        shift=request.shift,
        mask=request.mask_error,
    )
    return Distillation(request.teacher or teacher, options, until, request.device)


def quickest_device() -> str:
    """Device for networks that are large enough to gain by a GPU: "cuda" where torch sees one."""
    return devices()[-1]


def _with(options: Any, **values: Any) -> Any:
    """Options with the values that are not None in the place of their own."""
    return replace(options, **{name: value for name, value in values.items() if value is not None})
