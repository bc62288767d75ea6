"""Pokes of flip_mug and flip_cube in every engine: on which face an object comes to rest, and where a poke leaves it.

    python -m benchmarks.pokes [--pokes N] [--scenes NAME ...] [--out FOLDER]

The engines are the twin, Drake's plant with hydroelastic and with point contact, MuJoCo (converged) and Bullet, all
with the scene's theta; the pokes are those of `pinwm crosscheck`, which tip the object in the twin. A second table has
the twin with other time steps, and what a second of it costs. Results of a poke are kept in FOLDER.
"""

import argparse
import dataclasses
import math
import time
from collections.abc import Callable, Iterable
from pathlib import Path
from typing import Any

import numpy as np

from benchmarks import timing

timing.limit_threads(1, cpus=1)  # before numba and torch are imported

from benchmarks.next_push.engines import bullet, mujoco
from benchmarks.next_push.engines.rollout import LOG_RATE, Rollout, Theta, twin_truth
from benchmarks.next_push.objects import StandingAnyhow, Thing, make_thing
from benchmarks.next_push.pushes import Push
from pinwm_drake.files import replacing
from pinwm_drake.systems.crosscheck.motion import SEPARATED, Motion, SceneRig, unlimited
from pinwm_drake.systems.crosscheck.pokes import PokeVerdict, draw_pokes, judge
from pinwm_drake.systems.crosscheck.trials import Trial
from pinwm_drake.systems.scenario.load import load_setup
from pinwm_drake.systems.scenario.setup import Setup

SCENES = ("flip_mug", "flip_cube")
_STEPS = (240, 480, 960, 1920)  # Hz, of the twin
_AFTERWARDS = 2.0  # s, of an engine that is not ours, after the pusher stops
_Poked = Callable[[Trial], Motion]


def engines_of(setup: Setup, folder: Path) -> dict[str, _Poked]:
    """Functions that carry out a poke, by the engine's name; the twin's first."""
    found: dict[str, _Poked] = {name: SceneRig(setup, name).run for name in ("twin", "hydroelastic", "point")}
    thing = make_thing(str(setup.scenario.object), folder / "objects")
    thing = StandingAnyhow(**{field.name: getattr(thing, field.name) for field in dataclasses.fields(thing)})
    truth = twin_truth(setup.twin)
    for name, engine in (("mujoco", mujoco), ("bullet", bullet)):
        found[name] = lambda trial, engine=engine: _elsewhere(setup, engine.roll_out, thing, truth, trial)
    return found


def _elsewhere(setup: Setup, roll_out: Callable[..., Rollout], thing: Thing, theta: Theta, trial: Trial) -> Motion:
    """Motion of a poke in an engine that is not ours."""
    shape = setup.twin.pusher.shape
    assert shape is not None
    steps = math.ceil((trial.push.end_time + _AFTERWARDS) * LOG_RATE)
    t = np.arange(steps + 1) / LOG_RATE
    found = roll_out(thing, theta, trial.X_WO, Push(shape, trial.push, 0), t)
    p_WO = np.array([X.translation() for X in found.X_WO])
    q_WO = np.array([X.rotation().ToQuaternion().wxyz() for X in found.X_WO])
    stop = min(math.ceil(trial.push.end_time * LOG_RATE), steps)
    none, modes = np.zeros(steps + 1), np.full(steps + 1, SEPARATED)
    return Motion(t, p_WO, q_WO, found.p_WP, none, none, modes, modes, stop, None, "")


def kept(path: Path, trial: Trial, poke: _Poked) -> tuple[Motion, float]:
    """Motion of a poke and the CPU time [s] that it took, kept in a file."""
    if not path.exists():
        began = time.process_time()
        motion = poke(trial)
        arrays = {field.name: getattr(motion, field.name) for field in dataclasses.fields(motion)}
        arrays["rest"] = -1 if motion.rest is None else motion.rest
        path.parent.mkdir(parents=True, exist_ok=True)
        with replacing(path) as temporary:
            np.savez(temporary, seconds=time.process_time() - began, **arrays)
    with np.load(path) as file:
        values: dict[str, Any] = dict(file)
    seconds, rest = float(values.pop("seconds")), int(values.pop("rest"))
    scalars = {"stop": int(values.pop("stop")), "failure": str(values.pop("failure"))}
    return Motion(**values, **scalars, rest=None if rest < 0 else rest), seconds


def tables(name: str, out: Path, number: int) -> list[str]:
    """Lines of the tables of a scene, in Markdown."""
    setup = unlimited(load_setup(name))
    trials = draw_pokes(setup, number, 0)
    home = out / name
    motions: list[dict[str, Motion]] = [{} for _ in trials]
    costs: dict[str, float] = {}
    for engine, poke in engines_of(setup, out).items():
        _run(home, engine, trials, poke, motions, costs)
    lines = [
        f"| {name}, {number} pokes | other face than the majority | gave up | from the twin at the pusher's stop: "
        "median | nine of ten | CPU a second |",
        "| --- | --- | --- | --- | --- | --- |",
    ]
    lines += [_row(one, costs[one.engine]) for one in judge(motions)]
    others: list[dict[str, Motion]] = [{} for _ in trials]
    usual = round(1.0 / setup.twin.time_step)
    for rate in sorted(_STEPS, key=lambda rate: rate != usual):
        twin = dataclasses.replace(setup.twin, time_step=1.0 / rate)
        steps = max(round(rate * setup.period), 1)
        physics = dataclasses.replace(setup.scenario.physics, time_step=1.0 / rate, steps_per_update=steps)
        changed = dataclasses.replace(
            setup, twin=twin, scenario=dataclasses.replace(setup.scenario, physics=physics), period=steps / rate
        )
        engine = "twin" if rate == usual else f"twin, 1/{rate} s"
        _run(home, engine, trials, SceneRig(changed, "twin").run, others, costs)
    lines += [_row(one, costs[one.engine]) for one in judge(others)[1:]]
    return lines


def _run(
    home: Path,
    engine: str,
    trials: list[Trial],
    poke: _Poked,
    motions: list[dict[str, Motion]],
    costs: dict[str, float],
) -> None:
    """Adds an engine's motions, and its CPU time for a second of them."""
    spent = simulated = 0.0
    for k, trial in enumerate(trials):
        motion, seconds = kept(home / f"{engine.replace('/', '-')}.{k:03d}.npz", trial, poke)
        motions[k][engine] = motion
        spent, simulated = spent + seconds, simulated + float(motion.t[-1])
    costs[engine] = spent / max(simulated, 1e-9)
    print(f"{home.name}, {engine}: {len(trials)} pokes, {spent:.0f} s", flush=True)


def _row(one: PokeVerdict, cost: float) -> str:
    cells = [
        f"{1e3 * one.translation[k]:.1f} mm, {one.rotation[k]:.2f} rad" if one.engine != "twin" else "" for k in (0, 1)
    ]
    return f"| {one.engine} | {one.other_face} | {one.failed} | {cells[0]} | {cells[1]} | {cost:.3g} s |"


def main(arguments: Iterable[str] | None = None) -> None:
    """Runs the command."""
    parser = argparse.ArgumentParser(prog="python -m benchmarks.pokes")
    parser.add_argument("--pokes", type=int, default=100, help="for each scene")
    parser.add_argument("--scenes", nargs="+", choices=SCENES, default=SCENES, metavar="NAME")
    parser.add_argument("--out", type=Path, default=Path("out/pokes"), help="what is there stays")
    given = parser.parse_args(None if arguments is None else list(arguments))
    for name in given.scenes:
        print("\n".join(tables(name, given.out, given.pokes)), flush=True)


if __name__ == "__main__":
    main()
