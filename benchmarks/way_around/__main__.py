# SPDX-License-Identifier: MIT
"""Diffusion policy on a small known problem, beside its expert, regression to the mean, and chance.

    python -m benchmarks.way_around OUT [--episodes N] [--updates N] [--seed S]

It records N episodes of the expert in OUT/demonstrations, trains in OUT/diffusion (a call that was stopped goes on),
draws OUT/training.png, and prints the curve and the success rates with Wilson's 95 % intervals.
"""

import argparse
from pathlib import Path

import torch

from benchmarks.way_around.methods import around_method, train_mean
from benchmarks.way_around.worlds import Anyhow, AroundWorlds, Expert, MakeAround, success
from pinwm_drake.files import prepare_folder
from pinwm_drake.learning.method import MethodData
from pinwm_drake.learning.progress import silent
from pinwm_drake.learning.rounds import HISTORY_FILE
from pinwm_drake.paper.baselines.diffusion.demonstrations import collect_demonstrations, read_demonstrations
from pinwm_drake.paper.baselines.diffusion.method import STAGE
from pinwm_drake.report.figures.training import training_figure


def main() -> None:
    """Return records, trains and compares."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("out", type=Path)
    parser.add_argument("--episodes", type=int, default=50)
    parser.add_argument("--updates", type=int, default=2400)
    parser.add_argument("--seed", type=int, default=0)
    given = parser.parse_args()
    torch.set_num_threads(1)
    out, recorded = prepare_folder(given.out), given.out / "demonstrations"
    collect_demonstrations(AroundWorlds(), Expert(given.seed), recorded, given.episodes, seed=given.seed)
    worlds, diffusion = MakeAround(), around_method(given.updates)
    actor = diffusion.train(MethodData(recorded), worlds, out, seed=given.seed, resume=True, report=silent)
    history = out / STAGE / HISTORY_FILE
    training_figure(out / "training.png", {STAGE: history})
    print(history.read_text())
    mean = train_mean(read_demonstrations(recorded), worlds.spec("rgb"), diffusion, given.seed)
    for name, policy in (("diffusion", actor), ("mean", mean), ("expert", Expert(1)), ("random", Anyhow())):
        found = success(policy)
        low, high = found.interval
        print(f"{name:10} {found.successes} of {found.episodes}: {found.success_rate:.1%} ({low:.1%} to {high:.1%})")


if __name__ == "__main__":
    main()
