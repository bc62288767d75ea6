"""Trial of a teacher that learns by gradient through the step (SHAC), beside SAC, in the twin of the push.

    python -m benchmarks.short_horizon OUT [--only NAME ...] [--minutes M] [--seed S]
    python -m benchmarks.short_horizon OUT --quick

First the gradient itself: what it costs, whether it is right, and how it varies. Then trainings, each of M minutes of
one CPU at the most, one after another; their evaluations are those of `pinwm train`, and stand in OUT/NAME.csv. What is
there stays. In the end the table of all of them. `--quick` takes a few minutes, and shows nothing but that it runs.
"""

import argparse
import dataclasses
import os
from pathlib import Path

from benchmarks import timing

timing.limit_threads(1, os.cpu_count())  # before numba and torch are imported
os.environ["PINWM_THREADS"] = "1"

import torch  # noqa: E402

from benchmarks.short_horizon import gradients  # noqa: E402
from benchmarks.short_horizon.learner import LearnerOptions  # noqa: E402
from benchmarks.short_horizon.training import SETTINGS, Budget, read_rows, train_control, train_short  # noqa: E402
from pinwm_drake.cousins.domain import CousinDomains  # noqa: E402
from pinwm_drake.files import prepare_folder  # noqa: E402
from pinwm_drake.systems.envs.training_worlds import TrainingWorlds, training_options  # noqa: E402

SAC, GRADIENTS = "sac", "gradients"
NOISES = (0.15, 0.5)
BARS = (0.5, 0.9, 0.95)
QUICK = Budget(minutes=1.0, steps=8_192, round_steps=4_096, episodes=32)


def make_training(scene: str = "push_t") -> TrainingWorlds:
    """Worlds of a training that are all the twin."""
    return TrainingWorlds(scene, training_options(), num_worlds=gradients.WORLDS, domains=CousinDomains(delta=0.0))


def report_gradients(training: TrainingWorlds, path: Path, *, quick: bool) -> None:
    """Measures the gradient, and writes and prints the tables."""
    lines = ["| of 64 worlds, an action | CPU ms |", "| --- | --- |"]
    for name, samples in gradients.cost(training, 2 if quick else 15).items():
        each = samples.summary(1e3)
        lines.append(f"| {name} | {each['median']:.1f} ({each['q1']:.1f} to {each['q3']:.1f}) |")
    learners = [gradients.fresh(training, LearnerOptions(noise=noise, critic_first=10), 0) for noise in NOISES]
    heads = " | ".join(f"noise {noise:g}: step, likelihood, cosine" for noise in NOISES)
    lines += ["", f"| actions | right, wrong, kink | slope: step, differences | {heads} |"]
    lines.append(f"| --- | --- | --- |{' --- |' * len(NOISES)}")
    for horizon in gradients.HORIZONS[:2] if quick else gradients.HORIZONS:
        counts = gradients.against_differences(training, horizon)
        right = ", ".join(str(counts[name]) for name in ("right", "wrong", "kink"))
        mean = gradients.slope(training, horizon, 0.3, 2 if quick else 12)
        slopes = ", ".join(f"{mean[name]:.3f} ± {mean[f'{name}, error']:.3f}" for name in ("step", "differences"))
        signals = [gradients.signal(learner, horizon, 3 if quick else 12) for learner in learners]
        cells = (", ".join(f"{one[name]:.2g}" for name in ("through", "likelihood", "cosine")) for one in signals)
        lines.append(f"| {horizon} | {right} | {slopes} | {' | '.join(cells)} |")
        path.write_text("\n".join(lines) + "\n")
        print(lines[-1], flush=True)
    print(path.read_text(), flush=True)


def table(out: Path) -> str:
    """Table of the trainings that are there."""
    lines = [
        f"| training | {' | '.join(f'{100 * bar:.0f} % after' for bar in BARS)} | best | last |",
        f"| --- |{' --- |' * len(BARS)} --- | --- |",
    ]
    for path in sorted(out.glob("*.csv")):
        rows, cells = read_rows(path), []
        for bar in BARS:
            reached = next((row for row in rows if row.success >= bar), None)
            cells.append("-" if reached is None else f"{reached.steps:,} steps, {reached.seconds / 60:.1f} min")
        for row in (min(rows, key=lambda one: one.length), rows[-1]):
            cells.append(
                f"{100 * row.success:.0f} % in {row.length:.1f}, {row.steps:,} steps, {row.seconds / 60:.1f} min"
            )
        lines.append(f"| {path.stem} | {' | '.join(cells)} |")
    return "\n".join(lines)


def main() -> None:
    """Runs the trial."""
    parser = argparse.ArgumentParser(
        prog="python -m benchmarks.short_horizon",
        description=__doc__,
        formatter_class=argparse.RawDescriptionHelpFormatter,
    )
    names = (GRADIENTS, SAC, *SETTINGS)
    parser.add_argument("out", type=Path)
    parser.add_argument("--only", nargs="+", metavar="NAME", choices=names, help=f"any of: {'; '.join(names)}")
    parser.add_argument("--minutes", type=float, default=Budget().minutes, help="of the CPU, for each training")
    parser.add_argument("--scene", default="push_t", help="a scenario, or the folder of a twin")
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--quick", action="store_true")
    given = parser.parse_args()
    torch.set_num_threads(1)
    out, training = prepare_folder(given.out), make_training(given.scene)
    budget = QUICK if given.quick else dataclasses.replace(Budget(), minutes=given.minutes)
    for name in given.only or ((GRADIENTS, SAC, next(iter(SETTINGS))) if given.quick else names):
        path = out / f"{name.replace(', ', '_').replace(' ', '_')}.csv"
        if name == GRADIENTS:
            report_gradients(training, out / "gradients.md", quick=given.quick)
        elif not path.exists() and name == SAC:
            train_control(training, budget, path, out / "sac", given.seed)
        elif not path.exists():
            train_short(training, SETTINGS[name], budget, path, given.seed)
    print(table(out))


if __name__ == "__main__":
    main()
