# SPDX-License-Identifier: MIT
"""Frictions by one poke each: pokes that are drawn by number, in engines with small steps, fitted by their poses.

    python -m benchmarks.next_push.pokes OUT [--engine ENGINE ...] [--first K] [--number N] [--seeds S] [--lump]

Objects are the lying mug, the lying mug with a handle and the cube in turn; frictions, starts and pokes follow from the
number. With --lump, objects are lying mugs with a lump in their wall, 6 mm off the axis, which the fit is not told of.
Poses of 24 a second for two seconds, with noise of 0.2 mm and 0.2 degrees, stand for a pose estimator. Results are
lines of OUT; those that are there are not made anew.
"""

import argparse
import json
import math
import tempfile
import time
from collections.abc import Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import torch
from pydrake.common.eigen_geometry import Quaternion
from pydrake.math import RotationMatrix

from benchmarks import timing

if __name__ == "__main__":
    timing.limit_threads(1)  # before numba and torch are imported

from benchmarks.next_push.engines.rollout import Tip, twin_truth
from benchmarks.next_push.objects import StandingAnyhow
from benchmarks.results import markdown
from pinwm_drake.capture.episode_tables import POSES_FILE, TRAJECTORY_FILE, ObjectPoses
from pinwm_drake.capture.episodes import read_episode_folder
from pinwm_drake.capture.measured_poses import read_measured_poses
from pinwm_drake.capture.write import write_capture_yaml, write_pose_table, write_trajectory
from pinwm_drake.experiments.next_push import trajectory_of
from pinwm_drake.geometry.stored_pieces import mesh_pieces, mesh_primitives
from pinwm_drake.identification.options import IdentifyOptions
from pinwm_drake.identification.poses.fit import identify_poses
from pinwm_drake.spatial.poses import Pose
from pinwm_drake.spatial.rotations import quaternion_exp, quaternion_multiply
from pinwm_drake.systems.crosscheck.motion import SceneRig, unlimited
from pinwm_drake.systems.crosscheck.pokes import draw_pokes
from pinwm_drake.systems.crosscheck.trials import Trial
from pinwm_drake.systems.runs.realism.uneven import uneven_twin
from pinwm_drake.systems.scenario.load import load_setup
from pinwm_drake.systems.scenario.setup import Setup

ENGINES = ("hydroelastic", "point", "mujoco")
SCENES = {"mug": "flip_mug", "mug_handle": "flip_mug_handle", "cube": "flip_cube"}
LUMPY = "mug_lump"
_HEADER = (
    "engine, fitted by | pokes | error of the floor's friction, median | within 5 % | within 10 % "
    "| its 95 % interval holds | that of the pusher's friction holds, or it is called unknown "
    "| other seeds of the search are within that interval of the floor's friction"
)
_FRICTIONS = ("friction_floor", "friction_pusher")
_FLOOR, _PUSHER = (0.1, 0.4), (0.4, 1.0)
_STEP, _STEPS_PER_LOG = 1 / 15360, 128  # s, of Drake's plants; in 1/240 s of MuJoCo
_RATE, _SECONDS = 24.0, 2.0
_NOISE = 2e-4, math.radians(0.2)  # m, rad
_WAYS = {False: "poses", True: "poses, mugs with a lump"}


def poke(number: int, *, lump: bool = False) -> tuple[str, Setup, Trial]:
    """Object, scene with the truth, and poke of a number; the object is a mug with a lump where that is asked for."""
    generator = np.random.default_rng([7, number])
    name = LUMPY if lump else list(SCENES)[number % len(SCENES)]
    floor, pusher = (round(float(generator.uniform(*ends)), 3) for ends in (_FLOOR, _PUSHER))
    setup = load_setup(SCENES["mug" if lump else name])
    theta = {"friction_floor": floor, "friction_pusher": pusher, "restitution_floor": 0.0, "restitution_pusher": 0.0}
    twin = setup.twin.with_theta(**theta)
    twin = replace(twin, support="patch", time_step=1 / 960, acts_as=mesh_primitives(twin.mesh_path), nuisance={})
    setup = unlimited(replace(setup, twin=twin, plant_time_step=_STEP))
    if lump:
        setup = _with_lump(setup)
    return name, setup, draw_pokes(setup, 1, int(generator.integers(2**31)))[0]


def _with_lump(setup: Setup) -> Setup:
    """Scene with a lump in its object, which begins as it comes to rest."""
    start = setup.scenario.start
    q_WO = np.array(start.q_WO) / np.linalg.norm(start.q_WO)
    up = RotationMatrix(Quaternion(wxyz=q_WO)).matrix()[2]
    twin = uneven_twin(setup.twin, up, np.random.default_rng(0), Path(), feet=False)
    scenario = replace(setup.scenario, start=replace(start, rolls=1))
    return replace(setup, twin=twin, scenario=scenario)


def motion(setup: Setup, trial: Trial, engine: str) -> ObjectPoses:
    """Poses of the object from the start on, in an engine."""
    t = np.arange(0.0, _SECONDS, 1.0 / _RATE)
    if engine == "mujoco":
        twin = setup.twin
        hulls = tuple(np.asarray(piece.vertices) for piece in mesh_pieces(twin.mesh_path))
        thing = StandingAnyhow(twin.name, twin.mesh_path, twin.mesh_path, (), hulls)
        assert twin.pusher.shape is not None
        tip = Tip(twin.pusher.shape, np.asarray(trial.push.p_WP, float).copy())
        # It may not be installed.
        from benchmarks.next_push.engines.mujoco import PokedScene

        scene = PokedScene(thing, twin_truth(twin), trial.X_WO, tip, steps_per_log=_STEPS_PER_LOG, acts_as=twin.acts_as)
        found = scene.roll_out(t, trial.push)
        places = [X.translation() for X in found.X_WO]
        turns = [X.rotation().ToQuaternion().wxyz() for X in found.X_WO]
        return ObjectPoses(t, np.array(places), np.array(turns))
    moved = SceneRig(setup, engine).run(trial)
    # It ends when the object rests.
    rows = np.minimum(np.searchsorted(moved.t, t), len(moved.t) - 1)
    return ObjectPoses(t, moved.p_WO[rows], moved.q_WO[rows])


def measured(poses: ObjectPoses, generator: np.random.Generator) -> ObjectPoses:
    """Poses with the noise of an estimator."""
    place, turn = _NOISE
    noise = quaternion_exp(torch.from_numpy(generator.normal(0.0, turn, (len(poses.t), 3))))
    q = quaternion_multiply(noise, torch.from_numpy(poses.q_WO.copy()))
    return ObjectPoses(poses.t, poses.p_WO + generator.normal(0.0, place, poses.p_WO.shape), q.numpy())


def fit(setup: Setup, trial: Trial, poses: ObjectPoses, seeds: Sequence[int]) -> list[dict[str, Any]]:
    """Estimates of the frictions with their intervals, for each seed of the search."""
    twin = setup.twin
    with tempfile.TemporaryDirectory() as folder:
        episode = Path(folder) / "episodes" / "0000"
        episode.mkdir(parents=True)
        X_WO = Pose(torch.from_numpy(poses.q_WO[0].copy()), torch.from_numpy(poses.p_WO[0].copy()))
        write_capture_yaml(
            Path(folder),
            name=twin.name,
            mesh=str(twin.mesh_path),
            mass=twin.theta["mass"].value,
            X_WO=X_WO,
            pusher_mesh=None,
            pusher_shape=twin.pusher.shape,
            floor_height=twin.floor_height,
            gravity=twin.gravity,
        )
        write_pose_table(episode / POSES_FILE, poses)
        write_trajectory(episode / TRAJECTORY_FILE, trajectory_of(trial.push))
        capture, push = read_episode_folder(episode)
        table = read_measured_poses(episode / POSES_FILE, X_WO)
        found = []
        for seed in seeds:
            options = IdentifyOptions(seed=seed, num_threads=1)
            theta = identify_poses(capture, [push], [table], twin.surfels, options=options).twin.theta
            one: dict[str, Any] = {name: [theta[name].value, *(theta[name].interval or ())] for name in _FRICTIONS}
            found.append(one | {"known": {name: theta[name].identifiable for name in _FRICTIONS}})
    return found


def table_lines(rows: Sequence[Mapping[str, Any]]) -> list[str]:
    """Lines of a table of stored rows, one for each way of fitting and engine."""
    lines = []
    for way, engine in dict.fromkeys((row["way"], row["engine"]) for row in rows):
        some = [row for row in rows if (row["way"], row["engine"]) == (way, engine)]
        errors = [abs(row["found"][0]["friction_floor"][0] / row["truth"]["friction_floor"] - 1.0) for row in some]
        near = [sum(error <= bar for error in errors) for bar in (0.05, 0.10)]
        floor, pusher = _FRICTIONS
        held = [
            sum(_holds(row, floor) for row in some),
            sum(_holds(row, pusher) or not row["found"][0]["known"][pusher] for row in some),
        ]
        median = 100.0 * float(np.median(errors))
        words = "MuJoCo" if engine == "mujoco" else engine
        agree = sum(map(_agree, some)) if all(len(row["found"]) > 1 for row in some) else "not run"
        lines.append((f"{words}, {way}", len(some), f"{median:.1f} %", *near, *held, agree))
    return markdown(_HEADER, lines)


def _holds(row: Mapping[str, Any], name: str) -> bool:
    _, low, high = row["found"][0][name]
    return bool(low <= row["truth"][name] <= high)


def _agree(row: Mapping[str, Any]) -> bool:
    """Whether estimates of the floor's friction from other seeds are in the interval of the first."""
    _, low, high = row["found"][0][_FRICTIONS[0]]
    return all(low <= one[_FRICTIONS[0]][0] <= high for one in row["found"])


def main() -> None:
    """Append a line for each poke and engine to OUT."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("out", type=Path, help="file of the results, one JSON object a line")
    parser.add_argument("--engine", nargs="+", choices=ENGINES, default=ENGINES)
    parser.add_argument("--first", type=int, default=0)
    parser.add_argument("--number", type=int, default=20)
    parser.add_argument("--seeds", type=int, default=3, help="seeds of the search of each")
    parser.add_argument("--lump", action="store_true", help="mugs with a lump in their wall")
    given = parser.parse_args()
    lines = given.out.read_text().splitlines() if given.out.exists() else []
    done = {(one["number"], one["engine"]) for one in map(json.loads, lines) if (one["object"] == LUMPY) == given.lump}
    for number in range(given.first, given.first + given.number):
        left = [engine for engine in given.engine if (number, engine) not in done]
        if not left:
            continue
        name, setup, trial = poke(number, lump=given.lump)
        truth = {key: setup.twin.theta[key].value for key in _FRICTIONS}
        for engine in left:
            began = time.perf_counter()
            poses = measured(motion(setup, trial, engine), np.random.default_rng([8, number]))
            row = {"number": number, "engine": engine, "way": _WAYS[given.lump], "object": name, "truth": truth}
            row |= {"found": fit(setup, trial, poses, range(given.seeds)), "seconds": time.perf_counter() - began}
            with given.out.open("a") as file:
                file.write(json.dumps(row) + "\n")
            floor = row["found"][0]["friction_floor"]
            words = f"floor {truth['friction_floor']}, found {floor[0]:.3f} ({floor[1]:.3f} to {floor[2]:.3f})"
            print(f"{number} {name} {engine}: {words}", flush=True)


if __name__ == "__main__":
    main()
