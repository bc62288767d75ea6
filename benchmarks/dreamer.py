# SPDX-License-Identifier: MIT
"""Learning curve of Dreamer V2 on the point mass of `scenes/point_mass.py`, from 100 recorded random episodes.

    python -m benchmarks.dreamer [--size 64] [--updates 1000] [--rounds 4] [--out FOLDER]

Success is counted in episodes that nothing was chosen by, beside random actions and the answer, which knows place and
velocity. What is in FOLDER goes on.
"""

import argparse
import csv
from functools import partial
from pathlib import Path

from benchmarks import timing

if __name__ == "__main__":
    timing.limit_threads(1, cpus=2)  # before torch is imported

import torch

from benchmarks.scenes.point_mass import Homing, PointMassWorlds, Wandering
from pinwm_drake.files import prepare_folder
from pinwm_drake.learning.evaluation import Acts
from pinwm_drake.learning.method import MethodData
from pinwm_drake.learning.progress import silent
from pinwm_drake.learning.rounds import HISTORY_FILE
from pinwm_drake.learning.world_evaluation import evaluate_worlds
from pinwm_drake.paper.baselines.dreamer.episodes import collect
from pinwm_drake.paper.baselines.dreamer.method import EPISODES, DreamerV2
from pinwm_drake.paper.baselines.dreamer.options import BehaviourOptions, ModelOptions, NetworkOptions
from pinwm_drake.paper.baselines.dreamer.training import BEHAVIOUR, CURVE_FILE, MODEL

_WORLDS, _RECORDED, _TESTED = 16, 100, 256
_SEED = 3_000_000  # of the last evaluation


def main() -> None:
    """Run the command."""
    parser = argparse.ArgumentParser(prog="python -m benchmarks.dreamer", description=__doc__)
    parser.add_argument("--size", type=int, default=64, help="side of the images, px")
    parser.add_argument("--updates", type=int, default=1000, help="of the world model")
    parser.add_argument("--rounds", type=int, default=4, help="of 100 updates of actor and critic")
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--out", type=Path, default=Path("out/dreamer"))
    given = parser.parse_args()
    torch.set_num_threads(1)
    worlds, out = PointMassWorlds(_WORLDS, given.size), prepare_folder(given.out)
    recorded = out / EPISODES
    collect(worlds.worlds("rgb_state"), partial(Wandering, _WORLDS), recorded, _RECORDED, seed=given.seed)
    method = DreamerV2(
        networks=NetworkOptions(deter=64, hidden=64, latents=8, classes=8, units=64),
        model=ModelOptions(updates=given.updates, length=12, learning_rate=1e-3),
        behaviour=BehaviourOptions(
            rounds=given.rounds,
            round_updates=100,
            batch_size=8,
            length=12,
            horizon=10,
            actor_rate=1e-3,
            critic_rate=1e-3,
        ),
    )
    data = MethodData(trajectories=recorded)
    policy = method.train(data, worlds, out, seed=given.seed, resume=True, report=silent)
    _print_table(out / MODEL / CURVE_FILE, "world model", every=max(given.updates // 200, 1))
    _print_table(out / BEHAVIOUR / HISTORY_FILE, "actor and critic")
    print("| policy | success | mean actions |\n| --- | --- | --- |")
    contestants: dict[str, Acts] = {
        "random actions": Wandering(_WORLDS, 1),
        "Dreamer V2": policy,
        "place and velocity known": Homing(),
    }
    for name, one in contestants.items():
        found = evaluate_worlds(worlds.worlds("rgb_state"), one, _TESTED, seed=_SEED)
        print(f"| {name} | {found.successes} of {_TESTED} | {found.mean_steps:.1f} |")


def _print_table(path: Path, title: str, every: int = 1) -> None:
    rows = list(csv.reader(path.read_text().splitlines()))
    print(f"{title}\n{', '.join(rows[0])}")
    chosen = rows[1::every]
    for row in chosen if chosen[-1] == rows[-1] else [*chosen, rows[-1]]:
        print(", ".join(f"{float(value):.4g}" for value in row))
    print()


if __name__ == "__main__":
    main()
