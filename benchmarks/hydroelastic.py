# SPDX-License-Identifier: MIT
"""Distance of the twin from Drake's contact in a push: the tables of docs/explanation/hydroelastic.md.

The same pushes go through several twins and through plants with shorter and shorter steps. `--agreement` measures how
far the twin is from both of Drake's contact models; that takes half an hour.
"""

import argparse
import dataclasses
import math
import os
from pathlib import Path

from benchmarks import results, timing

if __name__ == "__main__":
    timing.limit_threads(1, cpus=os.cpu_count())  # before numba and torch are imported

import numpy as np

from pinwm_drake.systems.crosscheck.crosscheck import crosscheck
from pinwm_drake.systems.crosscheck.difference import Difference, difference_of
from pinwm_drake.systems.crosscheck.motion import Motion, SceneRig, unlimited
from pinwm_drake.systems.crosscheck.options import CrossCheckOptions
from pinwm_drake.systems.crosscheck.pushes import PushCheck
from pinwm_drake.systems.crosscheck.trials import draw_trials
from pinwm_drake.systems.scenario.schema import Physics, Scenario, Start, Theta
from pinwm_drake.systems.scenario.setup import Setup, make_setup

PAGE = Path(__file__).resolve().parent.parent / "docs/explanation/hydroelastic.md"

_FRICTION, _PUSHES, _SEED = 0.1, 8, 0
_AGREEMENT = (("t_block", 0.03), ("t_block", 0.1), ("t_block", 0.3), ("cube", 0.3), ("mug", 0.5))
# Of the T-block at a friction of 0.3: the pushes after which both contact models are farthest from the twin.
_HARD_FRICTION, _HARD = 0.3, (0, 8, 12, 17, 18)
_STEPS = (("hydroelastic", 3840), ("hydroelastic", 15360), ("point", 3840), ("point", 15360), ("point", 61440))
_TWINS = {
    "as it is: patch, 1/240 s": Physics(),
    "steps of 1/960 s": Physics(time_step=1 / 960, steps_per_update=4),
    "on its corners": Physics(support="corners"),
}


def scene(name: str, friction: float, physics: Physics | None = None) -> Setup:
    """Return the setup of an object of 1 kg with the same friction on floor and pusher, at any yaw."""
    start, theta = Start(yaw=[-math.pi, math.pi]), Theta(1.0, friction, friction, 0.0)
    return unlimited(make_setup(Scenario(object=name, theta=theta, start=start, physics=physics or Physics())))


def _apart(motions: list[Motion], others: list[Motion]) -> str:
    ways, angles = _ends([difference_of(one, other) for one, other in zip(motions, others, strict=True)])
    return f"{np.median(ways):.2f} mm, {np.median(angles):.2f}°; {ways.max():.2f} mm, {angles.max():.2f}°"


def _ends(differences: list[Difference]) -> tuple[np.ndarray, np.ndarray]:
    """Differences in translation [mm] and rotation [degrees] after rest, one of each for every push."""
    ways, angles = np.array([[1e3 * one.translation, math.degrees(one.rotation)] for one in differences]).T
    return ways, angles


def agreement() -> str:
    """Table of the twin's differences from both contact models and, for comparison, from itself, in Markdown."""
    lines = [
        "| object | friction | compared with | after rest: median | most | pushes above 3 mm or 2° |",
        "| --- | --- | --- | --- | --- | --- |",
    ]
    for name, friction in _AGREEMENT:
        setup = scene(name, friction)
        found = crosscheck(setup, CrossCheckOptions(pushes=20))
        assert isinstance(found, PushCheck)
        rig = SceneRig(setup.with_theta(friction_floor=1.01 * friction), "twin")
        ends = {engine: [push.differences[engine] for push in found.pushes] for engine in ("hydroelastic", "point")}
        ends["itself with 1 % more friction on the floor"] = [
            difference_of(push.motions["twin"], rig.run(push.trial)) for push in found.pushes
        ]
        for other, differences in ends.items():
            ways, angles = _ends(differences)
            above, ended = int(((ways > 3) | (angles > 2)).sum()), np.isfinite(ways)
            medians = f"{np.median(ways):.2f} mm, {np.median(angles):.2f}°"
            most = f"{ways[ended].max():.1f} mm, {angles[ended].max():.1f}°"  # failed pushes are left out
            failed = "" if ended.all() else f", {int((~ended).sum())} failed"
            cells = f"{name} | {friction:g} | {other} | {medians} | {most} | {above} of {len(ways)}{failed}"
            lines.append(f"| {cells} |")
            print(lines[-1], flush=True)
    return "\n".join(lines)


def twins() -> str:
    """Table of settings of the twin, against hydroelastic contact, in Markdown."""
    usual = scene("t_block", _FRICTION)
    trials = draw_trials(usual, usual, _PUSHES, _SEED)
    rig = SceneRig(usual, "hydroelastic")
    drake = [rig.run(trial) for trial in trials]
    lines = ["| twin | from hydroelastic contact: median; most |", "| --- | --- |"]
    for name, physics in _TWINS.items():
        rig = SceneRig(scene("t_block", _FRICTION, physics), "twin")
        lines.append(f"| {name} | {_apart([rig.run(trial) for trial in trials], drake)} |")
        print(lines[-1], flush=True)
    return "\n".join(lines)


def steps() -> str:
    """Table of the hardest pushes with shorter and shorter steps of Drake's plants, against the twin, in Markdown."""
    usual = scene("t_block", _HARD_FRICTION)
    drawn = draw_trials(usual, usual, max(_HARD) + 1, _SEED)
    trials = [drawn[k] for k in _HARD]
    fine = scene("t_block", _HARD_FRICTION, Physics(time_step=1 / 1920, steps_per_update=8))
    twin_motions = [[SceneRig(setup, "twin").run(trial) for trial in trials] for setup in (usual, fine)]
    lines = [
        "| contact | step of the plant | from the twin: median; most | from one with 1/1920 s |",
        "| --- | --- | --- | --- |",
    ]
    for engine, number in _STEPS:
        rig = SceneRig(dataclasses.replace(usual, plant_time_step=1 / number), engine)
        motions = [rig.run(trial) for trial in trials]
        cells = [_apart(motions, others) for others in twin_motions]
        lines.append(f"| {engine} | 1/{number} s | {' | '.join(cells)} |")
        print(lines[-1], flush=True)
    return "\n".join(lines)


def main() -> None:
    """Measures and reports the figures."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--write", action="store_true", help="update docs/explanation/hydroelastic.md")
    parser.add_argument("--agreement", action="store_true", help="measure the twin against both contact models too")
    given = parser.parse_args()
    command = "python -m benchmarks.hydroelastic"
    tables = [("twins", twins, command), ("steps", steps, command)]
    if given.agreement:
        tables.append(("agreement", agreement, f"{command} --agreement"))
    for name, table, how in tables:
        if given.write:
            results.write_block(PAGE, name, table(), how)
        else:
            print(table(), flush=True)


if __name__ == "__main__":
    main()
