# SPDX-License-Identifier: MIT
"""Rehearsal of a bundle with a simulated arm over LCM, in real time: episodes of normal work, and faults."""

import functools
import json
import math
import multiprocessing
import os
import socket
import time
from collections.abc import Callable, Iterator
from contextlib import ExitStack, contextmanager
from dataclasses import asdict, dataclass, replace
from multiprocessing.connection import Connection
from pathlib import Path
from typing import Any

import numpy as np

from pinwm_drake.documents import read_json
from pinwm_drake.errors import InputError, ParameterError, PinwmError, StateError
from pinwm_drake.experiments.rehearsal.faults import CONTENT, IMAGE_LIMIT, KINDS, PACE, SILENCE, STALL, FaultKind
from pinwm_drake.experiments.rehearsal.processes import Traffic, robot_link, run_arm, run_relay, with_link
from pinwm_drake.experiments.requests.control import RehearseRequest
from pinwm_drake.files import occupying, replacing
from pinwm_drake.learning.bundle import Bundle, read_bundle
from pinwm_drake.learning.spec import PolicySpec
from pinwm_drake.provenance import timestamp, versions
from pinwm_drake.reading.contents import read_text
from pinwm_drake.reading.trees import parse_json
from pinwm_drake.systems.arm.driver import arm_limits
from pinwm_drake.systems.control.loop import ControlLoop
from pinwm_drake.systems.envs.options import EnvOptions, environment_setup
from pinwm_drake.systems.envs.policy_scene import policy_setup
from pinwm_drake.systems.scenario.schema import LcmLink
from pinwm_drake.systems.scenario.setup import Setup

RESULTS_FILE, TRIALS_FILE = "rehearsal.json", "trials.jsonl"
_PERIOD = 0.01  # s, of the link: with 5 ms two cores are not always enough for three processes in real time
_EARLIEST, _LATEST = 0.3, 1.5  # s after it was armed, of a fault
_AFTER = 0.4  # s after the controller stopped, for the robot to come to rest
_LONGEST = 3.0  # s after a fault, until a trial is given up
_AMOUNTS = ("faults", "moments", "minutes", "episodes", "port")  # of a request, which may be others when it goes on
_ATTEMPTS, _SEEDS = 10, 1_000_000  # of a start at which the task is not done at once, and seeds between two attempts
_OWN = "a rehearsal is of the policy's own scene"
_STARTING = 120.0  # s, for the arm to begin


@dataclass(frozen=True)
class Trial:
    """One fault at a moment, or one episode of normal work.

    Attributes:
        kind: Name of the fault; empty for normal work.
        seed: Seed of the start.
        after: s, from arming to the fault; None for normal work, and where the controller stopped before it.
        state: State of the controller at the end: "latched", "done" or "running".
        reason: Reason for it.
        to_zero: s, from the fault to the last command that moves the robot; 0 where none came after it.
        allowed: s, that this may take: until the fault can be known, and one action.
        zero: Flag: the last command on the wire is zero and of no session.
        at_rest: Flag: the robot was at rest at the end.
        success: Flag: the object was at the goal at the end, by the simulation; of normal work.
        actions: Number of actions.
        duration: s, from arming to the end.
    """

    kind: str
    seed: int
    after: float | None
    state: str
    reason: str
    to_zero: float
    allowed: float
    zero: bool
    at_rest: bool
    success: bool
    actions: int
    duration: float

    @property
    def good(self) -> bool:
        """Flag: the fault latched in time, zero on the wire and robot at rest; or the episode ended by itself."""
        if not self.kind:
            return self.state != "latched"
        stopped = self.after is not None and self.state == "latched"
        return stopped and self.to_zero <= self.allowed and self.zero and self.at_rest


class Disturbed:
    """Bundle that can be told to fail.

    Attributes:
        spec: Specification of the bundle.
        mask_pixels: Numbers of pixels of the object, as the bundle has them.
        begun: Time since which it fails, s, monotonic; NaN before.
    """

    def __init__(self, bundle: Bundle) -> None:
        self.spec: PolicySpec = bundle.spec
        self.mask_pixels = bundle.mask_pixels
        self._bundle = bundle
        self.tell("", math.inf)

    def tell(self, kind: str, due: float) -> None:
        """Tells it to fail in a kind [name of the fault] from a time [s, monotonic] on."""
        self._kind, self._due, self.begun = kind, due, math.nan

    def act(self, image: np.ndarray, p_WP: np.ndarray) -> np.ndarray:
        """Return the translation of the bundle; see `step`."""
        return self.step(image, p_WP)[0]

    def step(self, image: np.ndarray, p_WP: np.ndarray) -> tuple[np.ndarray, np.ndarray | None]:
        """Return translation and estimate of the bundle, or the failure that is due; arguments as for `Bundle.step`."""
        found = self._bundle.step(image, p_WP)
        if time.monotonic() < self._due:
            return found
        self.begun = time.monotonic() if math.isnan(self.begun) else self.begun
        if self._kind == "policy fails":
            raise RuntimeError("a failure on purpose, as the rehearsal asked for it")
        if self._kind == "policy of NaN":
            return np.full(self.spec.action_size, np.nan), found[1]
        time.sleep(STALL)
        return found


def rehearse(
    request: RehearseRequest, out: Path, *, resume: bool = False, report: Callable[[int, float, Trial], None]
) -> list[Trial]:
    """Rehearses a bundle, and writes each trial as soon as it is over.

    Args:
        request: The rehearsal.
        out: Folder of `trials.jsonl` and `rehearsal.json`.
        resume: Flag: trials that are there already are not made again.
        report: Called after each trial with its number, the share of the rehearsal that is done, and itself.

    Returns:
        All trials.

    Raises:
        InputError: The folder holds trials, and `resume` is not set; or bundle or scene cannot be used.
        StateError: The arm does not begin, or sends nothing.
    """
    with occupying(out):
        bundle = _aimed(request)
        setup = _scene(request, bundle)
        request = replace(request, scene=request.scene or setup.scenario.name)
        trials = _begun(out, request, bundle.sha256, resume)
        kinds = [kind for kind in KINDS if not request.kinds or kind.name in request.kinds]
        with ExitStack() as stack, (out / TRIALS_FILE).open("a") as file:
            parties = functools.cache(lambda: stack.enter_context(_parties(request, bundle, setup)))

            def keep(trial: Trial) -> None:
                trials.append(trial)
                file.write(json.dumps(asdict(trial), allow_nan=False) + "\n")
                file.flush()
                report(len(trials), _share(request, faults, trials), trial)

            faults = len(kinds) * request.moments if request.faults else 0
            for number in range(faults):
                moment, kind = divmod(number, len(kinds))
                seed = request.seed + moment
                if not any(one.kind == kinds[kind].name and one.seed == seed for one in trials):
                    keep(parties().fault(kinds[kind], seed))
            normal = [one for one in trials if not one.kind]
            number, spent = len(normal), sum(one.duration for one in normal)
            while number < request.normal_episodes or spent < 60.0 * request.minutes:
                keep(parties().episode(request.seed + number))
                number, spent = number + 1, spent + trials[-1].duration
        _write_results(out, request, bundle.sha256, trials)
        return trials


def _share(request: RehearseRequest, faults: int, trials: list[Trial]) -> float:
    """Share of a rehearsal that is done, where a fault and an episode count the same."""
    normal = [one for one in trials if not one.kind]
    shares = [len(normal) / request.normal_episodes] if request.normal_episodes else []
    shares += [sum(one.duration for one in normal) / (60.0 * request.minutes)] if request.minutes else []
    work = float(request.normal_episodes or (max(faults, 1) if request.minutes else 0))
    done = len(trials) - len(normal) + work * min([1.0, *shares])
    return min(done / (faults + work), 1.0)


def _aimed(request: RehearseRequest) -> Bundle:
    bundle = read_bundle(request.bundle)
    return bundle if request.goal is None else bundle.toward(request.goal)


def shortfall(request: RehearseRequest) -> str:
    """Shortfall of the simulated arm for a bundle, as `SafetyLimits.shortfall` says it.

    Raises:
        InputError: Bundle or scene cannot be used.
    """
    bundle = _aimed(request)
    return bundle.limits.shortfall(arm_limits(_scene(request, bundle), request.arm_model))


def scene_words(request: RehearseRequest) -> str:
    """Object, scene and engine of a rehearsal in words; raises InputError where bundle or scene cannot be used."""
    setup = _scene(request, _aimed(request))
    return f"{setup.twin.name} in {setup.scenario.name}, a simulated arm"


def _scene(request: RehearseRequest, bundle: Bundle) -> Setup:
    return policy_setup(bundle.spec, bundle.provenance, request.bundle, request.scene, _OWN)


def _begun(out: Path, request: RehearseRequest, sha256: str, resume: bool) -> list[Trial]:
    """Trials of a rehearsal that is to go on, or none, and the request written down.

    Raises:
        InputError: There are trials and `resume` is not set, or they are of another request or bundle.
    """
    path = out / TRIALS_FILE
    if not path.exists():
        _write_results(out, request, sha256, [])
        path.touch()
        return []
    if not resume:
        raise InputError(out, value="trials of a rehearsal", allowed="a new folder, or --resume to go on")
    before = read_json(out / RESULTS_FILE).value
    goal = None if request.goal is None else list(request.goal)
    now = {**asdict(request), "kinds": list(request.kinds), "goal": goal, "bundle": sha256}
    for name, value in {**before["request"], "bundle": before["bundle"]}.items():
        if name not in _AMOUNTS and now[name] != value:
            allowed = f"{value}, as it was begun with; or a new folder"
            raise InputError(out / RESULTS_FILE, value=f"{name} {now[name]}", allowed=allowed)
    return _read_trials(path)


def _read_trials(path: Path) -> list[Trial]:
    """Trials of a file; a last line that was cut off by a kill is dropped from it."""
    text = read_text(path)
    whole = text[: text.rfind("\n") + 1]
    if whole != text:
        with replacing(path) as temporary:
            temporary.write_text(whole)
    trials = []
    for row, line in enumerate(whole.splitlines(), start=1):
        try:
            trials.append(Trial(**parse_json(line, path)))
        except (TypeError, PinwmError) as error:
            raise InputError(path, row=row, value=line, allowed="a trial as `pinwm rehearse` writes it") from error
    return trials


def _write_results(out: Path, request: RehearseRequest, sha256: str, trials: list[Trial]) -> None:
    results = {
        "request": asdict(request),
        "bundle": sha256,
        "time": timestamp(),
        "versions": versions(),
        "cores": os.cpu_count(),
        "summary": summary(trials),
    }
    with replacing(out / RESULTS_FILE) as temporary:
        temporary.write_text(json.dumps(results, indent=1, allow_nan=False) + "\n")


def summary(trials: list[Trial]) -> dict[str, Any]:
    """Figures of a rehearsal: for each kind of fault, and for normal work."""
    found: dict[str, Any] = {"faults": {}}
    for kind in dict.fromkeys(one.kind for one in trials if one.kind):
        some = [one for one in trials if one.kind == kind]
        times = [one.to_zero for one in some]
        found["faults"][kind] = {
            "trials": len(some),
            "good": sum(one.good for one in some),
            "stopped_before": sum(one.after is None for one in some),
            "median_to_zero": float(np.median(times)),
            "longest_to_zero": max(times),
            "allowed": max(one.allowed for one in some),
            "reasons": sorted({one.reason.split(":")[0] for one in some}),
        }
    normal = [one for one in trials if not one.kind]
    if normal:
        found["normal"] = {
            "episodes": len(normal),
            "false_stops": sum(one.state == "latched" for one in normal),
            "successes": sum(one.success for one in normal),
            "minutes": sum(one.duration for one in normal) / 60.0,
            "reasons": sorted({one.reason.split(":")[0] for one in normal}),
        }
    return found


@contextmanager
def _parties(request: RehearseRequest, bundle: Bundle, scene: Setup) -> Iterator["_Parties"]:
    with ExitStack() as stack:
        held = stack.enter_context(socket.socket())  # another rehearsal on the port would hear the messages of this one
        try:
            held.bind(("127.0.0.1", request.port))
        except OSError as error:
            raise ParameterError(f"--port: got {request.port}, which is in use; allowed: a free one") from error
        setup = environment_setup(scene, EnvOptions(image_size=bundle.spec.camera.width))
        link = replace(setup.scenario.lcm, url=f"udpm://239.255.76.67:{request.port}?ttl=0", period=_PERIOD)
        context = multiprocessing.get_context("spawn")
        (arm, arm_end), (relay, relay_end) = context.Pipe(), context.Pipe()
        robot = with_link(setup, robot_link(link)), request.latency, request.arm_model
        for work, end, more in ((run_arm, arm_end, robot), (run_relay, relay_end, (link, os.getpid()))):
            process = context.Process(target=work, args=(end, *more), daemon=True)
            process.start()
            end.close()
            stack.callback(process.terminate)
            stack.callback(process.join, 5.0)
        stack.callback(relay.close)
        stack.callback(arm.close)
        yield _Parties(bundle, with_link(setup, link), link, arm, relay)


class _Parties:
    def __init__(self, bundle: Bundle, setup: Setup, link: LcmLink, arm: Connection, relay: Connection) -> None:
        self._bundle, self._setup, self._link = bundle, setup, link
        self._arm, self._relay = arm, relay
        self._policy = Disturbed(bundle)
        self._loop: ControlLoop | None = None

    def fault(self, kind: FaultKind, seed: int) -> Trial:
        """Trial of a fault at a random moment; with another start where the task was done before it could be known."""
        for attempt in range(_ATTEMPTS):
            trial = self._fault(kind, seed, seed + _SEEDS * attempt)
            if trial.state != "done" or (trial.after is not None and trial.duration > trial.after + trial.allowed):
                break
        return trial

    def _fault(self, kind: FaultKind, seed: int, start: int) -> Trial:
        """Trial of a fault, its moment by one seed, and start by another."""
        generator = np.random.default_rng([seed, KINDS.index(kind)])
        after = float(generator.uniform(_EARLIEST, _LATEST))
        loop, policy = self._armed(start), self._policy
        if kind.channel == "policy":
            policy.tell(kind.name, time.monotonic() + after)
        else:
            self._ask(self._relay, ("begin", kind.name, after))
        traffic, ending = self._run(loop, after + _LONGEST)
        begun = policy.begun if kind.channel == "policy" else traffic.begun
        late = traffic.moved - begun
        return Trial(
            kind=kind.name,
            seed=seed,
            after=None if math.isnan(begun) else after,
            to_zero=max(late, 0.0) if math.isfinite(late) else 0.0,
            allowed=self._known_after(kind) + self._bundle.spec.horizon,
            success=False,
            **ending,
        )

    def episode(self, seed: int) -> Trial:
        loop, spec = self._armed(seed), self._bundle.spec
        traffic, ending = self._run(loop, 2.0 * spec.max_steps * spec.horizon)
        state, _ = self._ask(self._arm, None)
        tool = np.array(traffic.robot[:3]) if traffic.robot else np.full(3, np.nan)
        success = bool(spec.task.measure(state[None], tool[None]).success[0])
        return Trial(kind="", seed=seed, after=None, to_zero=0.0, allowed=0.0, success=success, **ending)

    def _run(self, loop: ControlLoop, longest: float) -> tuple[Traffic, dict[str, Any]]:
        """Traffic of a run of at most `longest` [s] until the robot is at rest, and what a `Trial` has of its end.

        A fault that comes after the controller's end is none: it is not begun.
        """
        began = time.monotonic()
        try:
            for row in loop.advance(longest):
                status = row.status
        finally:
            loop.stop()
        duration = time.monotonic() - began
        self._ask(self._relay, "end")
        time.sleep(_AFTER)
        traffic: Traffic = self._ask(self._relay, "tell")
        return traffic, {
            "state": status.state,
            "reason": status.reason,
            "zero": bool(traffic.last) and not any(traffic.last[:4]),
            "at_rest": math.isfinite(traffic.rest),
            "actions": status.actions,
            "duration": duration,
        }

    def _armed(self, seed: int) -> ControlLoop:
        """Return the armed loop, with object and pusher in a new place and without a fault."""
        self._policy.tell("", math.inf)
        self._ask(self._relay, "clear", _STARTING)
        self._ask(self._arm, seed, _STARTING)
        self._ask(self._relay, "clear")
        if self._loop is None:
            # One for all trials: each has a connection of its own to LCM, which hears everything.
            self._loop = ControlLoop(self._policy, self._bundle.limits, self._setup, "lcm", armed=True)
            self._loop.begin(self._loop.draw_place(np.random.default_rng(0)))
        self._loop.listen()
        return self._loop

    def _known_after(self, kind: FaultKind) -> float:
        """Time [s] after which a fault can be known at the earliest."""
        link, spec = self._link, self._bundle.spec
        return {
            CONTENT: link.image_period if kind.channel == "image" else 2.0 * link.period,
            IMAGE_LIMIT: self._bundle.limits.max_image_age,
            SILENCE: link.timeout,
            PACE: spec.horizon,
        }[kind.known] + (STALL if kind.name in ("slow policy", "stopped process") else 0.0)

    @staticmethod
    def _ask(pipe: Connection, order: Any, patience: float = 10.0) -> Any:
        pipe.send(order)
        if not pipe.poll(patience):
            raise StateError(
                f"rehearsal: no answer of the simulated arm within {patience:g} s; "
                "free the machine of other work, and go on with --resume"
            )
        return pipe.recv()
