# SPDX-License-Identifier: MIT
"""Errors of a twin after one random action: how far its object is from that of a plant that began in the same state.

    python -m benchmarks.one_step SCENE [--twin TWIN ...] [--engine ENGINE] [--draws N] [--seed S] [--way M] [--rest K]

Object and pusher begin as the scene draws them; the action is one of full length towards a random point of the box
around the object; actions that miss it do not count. Compared are the poses of the object when the action ends, while
it still moves; with --rest when it rests, after K actions of standing still at the most. The plant has SCENE's theta.
Twins take the object's place, such as identified ones. First comes the scene's own theta: the engines' difference.
"""

import argparse

import numpy as np

from benchmarks import timing

if __name__ == "__main__":
    timing.limit_threads(1)  # before numba and torch are imported

from pinwm_drake.paper.one_step import outcomes_at_rest, plant_outcomes, step_errors
from pinwm_drake.systems.scenario.load import load_setup


def main() -> None:
    """Print medians, means and the 95th percentiles of both errors."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("scene")
    parser.add_argument("--twin", action="append", default=[])
    parser.add_argument("--engine", default="hydroelastic", choices=("hydroelastic", "point", "twin"))
    parser.add_argument("--draws", type=int, default=200)
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--way", type=float, help="m, of the pusher in an action; else the longest")
    parser.add_argument("--rest", type=int, default=0)
    given = parser.parse_args()
    outcomes = plant_outcomes(given.scene, given.engine, given.draws, given.seed, max_translation=given.way)
    if given.rest:
        outcomes = outcomes_at_rest(given.scene, given.engine, outcomes, given.rest)
    for twin in (None, *given.twin):
        found = step_errors(load_setup(given.scene, twin=twin), outcomes, given.rest)
        print(twin or f"{given.scene}'s own theta")
        for name, unit, values in (("translation", "mm", 1e3 * found[:, 0]), ("rotation", "rad", found[:, 1])):
            mean, median, high = values.mean(), np.median(values), np.quantile(values, 0.95)
            print(f"  {name}: mean {mean:.3g} {unit}, median {median:.3g} {unit}, 95th percentile {high:.3g} {unit}")


if __name__ == "__main__":
    main()
