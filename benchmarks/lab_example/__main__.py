# SPDX-License-Identifier: MIT
"""Worked example of docs/how-to/lab.md: a rendered lab, act by act, from a printed board to a predicted second push.

    python -m benchmarks.lab_example OUT [--seed 0] [--cad] [--engine hydroelastic] [--policy MINUTES] [--write]

OUT/mylab is the lab, OUT/truth what nobody tells it. `pinwm lab` is called after each act of a person, which is the
act that it asked for. `--cad` puts the object's CAD file into mesh/ too; without it the mesh is the hull of the masks.
`--policy` then trains a policy for the lab's camera and rehearses it in hydroelastic contact. `--write` stores the
figures in docs/results/lab_example.json. A run that was stopped goes on where it was.
"""

import argparse
import json
import os
import shutil
import sys
from collections.abc import Callable
from pathlib import Path
from typing import Any
from unittest.mock import patch

import cv2
import yaml

from benchmarks.lab_example.picture import write_picture
from benchmarks.lab_example.scene import COLUMNS, MASS, PRINTED, WORKSPACE, ExampleLab, Sizes
from benchmarks.lab_example.score import figures, table
from benchmarks.results import machine, write_block
from benchmarks.scenes.lab_scenes import TIP
from pinwm_drake.capture.scene import EPISODES
from pinwm_drake.documents import read_yaml
from pinwm_drake.experiments.progress import silent
from pinwm_drake.files import prepare_folder
from pinwm_drake.guide.guide import guide_lab
from pinwm_drake.guide.lab import OBJECT_FILE, LabFolder
from pinwm_drake.guide.new import new_lab
from pinwm_drake.guide.record import Entry, Record
from pinwm_drake.guide.runs import PROPOSAL_FILE, run_push
from pinwm_drake.guide.stages import ACTS, AGAIN, FILL_IN, LENS, MESH, PHOTOS, PRINT, PUSH, ROBOT, TABLE
from pinwm_drake.provenance import timestamp
from pinwm_drake.spatial.rigid import from_pose
from pinwm_drake.station.lab import LAB_FILE, POSES_FILE
from pinwm_drake.systems.pusher.motion import StraightPush

RESULT = Path(__file__).resolve().parents[2] / "docs/results/lab_example.json"
PAGE = RESULT.parent.parent / "how-to/lab.md"
PICTURE = RESULT.parent.parent / "assets/lab_example.jpg"
FIRST_TWIN = "first_twin"  # in OUT: the twin of the first push
_RECORD = "example.json"  # in OUT/truth: acts and CPU times


class Example:
    """The person in the lab: does the act that the guide asks for.

    Attributes:
        lab: The lab's folder.
        truth: What is true of it.
        acts: Numbers of the acts that were done, in their order.
        cpu: s, of the stages by their keys.
    """

    def __init__(self, out: Path, seed: int, *, cad: bool, sizes: Sizes, engine: str = "hydroelastic") -> None:
        self.out, self.cad = out, cad
        self.truth = ExampleLab(seed, out, sizes, engine)
        self._file = prepare_folder(out / "truth") / _RECORD
        known = json.loads(self._file.read_text()) if self._file.is_file() else {"acts": [], "cpu": {}}
        self.acts: list[int] = known["acts"]
        self.cpu: dict[str, float] = known["cpu"]
        path = out / "mylab"
        self.lab = LabFolder(path) if path.is_dir() else new_lab(path)

    def run(self, *, run: bool = True, last: int = AGAIN) -> str:
        """Do act after act until `last` is done or the guide is stuck; returns why it is stuck, "" where it is not."""
        while last not in self.acts:
            found = self.guide(run=run)
            if found.error or found.number is None:
                return found.error or found.act
            act = found.number - 1
            if act > last:
                return ""
            if act in self.acts:
                return f"asked twice: {found.act}"
            print(f"act {act + 1} of {len(ACTS)}: {found.act}", flush=True)
            self.do(act)
        return ""

    def guide(self, *, run: bool = True) -> Any:
        """Call what `pinwm lab` calls, and keep the CPU time of each stage."""
        begun: dict[str, float] = {}
        put: Callable[[Record, str, Entry], None] = Record.put

        def timed(record: Record, key: str, entry: Entry) -> None:
            put(record, key, entry)
            if entry.error == "interrupted":
                begun[key] = _cpu()
            elif key in begun:
                self.cpu[key] = round(_cpu() - begun.pop(key), 1)
                print(f"{key}: {entry.error or '; '.join(entry.notes)} ({self.cpu[key]} s)", flush=True)
                self._keep()

        with patch.object(Record, "put", timed):
            return guide_lab(self.lab.path, run=run)

    def do(self, act: int) -> None:
        """Do an act of a person."""
        path = self.lab.path
        if act == PRINT:
            self._fill_in(LAB_FILE, ruler=0.1 * PRINTED)
        elif act == FILL_IN:
            self._fill_in(LAB_FILE, workspace=WORKSPACE, tool={"shape": {"kind": "sphere", "radius": TIP}})
            self._fill_in(OBJECT_FILE, name="t_block", mass=MASS, columns=COLUMNS)
        elif act in (LENS, ROBOT, TABLE):
            self._photos_of_board({LENS: "lens", ROBOT: "robot", TABLE: "table"}[act])
        elif act == PHOTOS:
            self.truth.write_photos(path / "photos")
            if self.cad:
                shutil.copyfile(self.truth.thing.mesh_path, path / "mesh/object.obj")
                self.acts.append(MESH)
        elif act == PUSH:
            self.truth.write_push(0, self.proposed(self.lab.first), path / "pushes/0000")
        elif act == AGAIN:
            self.second_push()
        else:
            raise ValueError(ACTS[act])
        self.acts.append(act)
        self._keep()

    def second_push(self) -> None:
        """Keep the twin of the first push, and film the push that the guide proposed."""
        kept = self.out / FIRST_TWIN
        if not kept.is_dir():
            shutil.copytree(self.lab.twin, kept)
        self.truth.write_push(1, self.proposed(self.lab.next), self.lab.path / "pushes/0001")

    def proposed(self, folder: Path) -> StraightPush:
        """Push that the guide proposed in a folder of the lab."""
        station = self.lab.read_station()
        assert station is not None
        X_BW = from_pose(station.document.world.X_BW.pose())
        return self.truth.as_told(read_yaml(folder / PROPOSAL_FILE).value["push"], X_BW)

    def add_others(self) -> None:
        """Add the proposed push and another one of a person as episodes, as the guide does.

        They are predicted by the twin of the first push, so that none is identified from.
        """
        another = self.lab.path / "pushes/0002"
        if not another.is_dir():
            self.truth.write_push(2, self.truth.own_push(), another)
        for push in (self.lab.path / "pushes/0001", another):
            if (self.lab.capture / EPISODES / push.name).is_dir():
                continue
            begun = _cpu()
            for line in run_push(push, self.lab, silent):
                print(f"push {push.name}: {line}", flush=True)
            self.cpu[f"push {push.name}"] = round(_cpu() - begun, 1)
            self._keep()

    def _photos_of_board(self, kind: str) -> None:
        """Put the photos of a set into the lab; all are drawn at once, as the robot's noise is of one sequence."""
        drawn = self.out / "truth/board"
        if not drawn.is_dir():
            drawn.mkdir(parents=True)
            self.truth.board.write(drawn)
        shutil.copytree(drawn / kind, self.lab.path / kind, dirs_exist_ok=True)
        if kind == "robot":
            shutil.copyfile(drawn / POSES_FILE, self.lab.path / POSES_FILE)

    def _fill_in(self, file: str, **values: object) -> None:
        path = self.lab.path / file
        path.write_text(yaml.safe_dump({**yaml.safe_load(path.read_text()), **values}, sort_keys=False))

    def _keep(self) -> None:
        self._file.write_text(json.dumps({"acts": self.acts, "cpu": self.cpu}, indent=1) + "\n")


def _cpu() -> float:
    """CPU time [s] of this process and of its children."""
    return sum(os.times()[:4])


def rehearse(example: Example, minutes: float) -> dict[str, Any]:
    """Train a policy for the lab's camera within a time, and rehearse it in hydroelastic contact."""
    from pinwm_drake.experiments import training
    from pinwm_drake.experiments.evaluation.run import evaluate
    from pinwm_drake.experiments.requests.evaluate import EvaluateRequest
    from pinwm_drake.experiments.requests.train import TrainRequest

    lab = example.lab
    training.train(TrainRequest(scene=str(lab.twin), out=lab.policy, station=lab.station, minutes=minutes))
    found = evaluate(EvaluateRequest(policy=str(lab.policy), engine="hydroelastic"), example.out / "evaluation")
    return {"minutes": minutes, "success rate": found.success_rate, "actions": found.mean_steps}


def main() -> None:
    """Do the acts, score what the guide found, print the figures, and store them with `--write`."""
    parser = argparse.ArgumentParser(
        prog="python -m benchmarks.lab_example",
        description=__doc__,
        formatter_class=argparse.RawDescriptionHelpFormatter,
    )
    parser.add_argument("out", type=Path)
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--cad", action="store_true", help="put the CAD file into mesh/")
    parser.add_argument("--engine", choices=("hydroelastic", "point", "mujoco"), default="hydroelastic")
    parser.add_argument("--policy", type=float, metavar="MINUTES", help="train a policy, and rehearse it")
    parser.add_argument("--write", action="store_true", help="update docs/results/lab_example.json")
    given = parser.parse_args()
    cv2.setNumThreads(1)
    given.out.mkdir(parents=True, exist_ok=True)
    example = Example(given.out, given.seed, cad=given.cad, sizes=Sizes(), engine=given.engine)
    stuck = example.run()
    if stuck:
        sys.exit(stuck)
    example.add_others()
    found: dict[str, Any] = {
        "acts": [ACTS[act].split(":")[0].split(".")[0] for act in example.acts],
        "acts in all": len(ACTS),
        **figures(example.truth, example.lab, given.out / FIRST_TWIN),
        "cpu_seconds": example.cpu,
    }
    if given.policy is not None:
        found["policy"] = rehearse(example, given.policy)
    options = f"--seed {given.seed}{' --cad' if given.cad else ''} --engine {given.engine}"
    command = f"python -m benchmarks.lab_example OUT {options} --write"
    name = "CAD file" if given.cad else "mesh of the masks"
    runs = json.loads(RESULT.read_text()) if given.write and RESULT.exists() else {}
    runs[name] = {"command": command, "machine": machine(), "date": timestamp(), **found}
    if given.write:
        RESULT.write_text(json.dumps(runs, indent=1) + "\n")
        write_block(PAGE, "lab_example", table(runs), command)
        if given.cad:
            write_picture(PICTURE, example.lab, given.out / FIRST_TWIN)
    else:
        print(table(runs), flush=True)


if __name__ == "__main__":
    main()
