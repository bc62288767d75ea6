# SPDX-License-Identifier: MIT
"""Derivatives of random contact scenes against central differences, all pairs of shapes and flips included.

    python -m benchmarks.contact_gradients --samples 10000

Every world of a batch of `contact_scenes`, or of a poke that flips an object, has a loss of its own: random weights on
the last frame's positions, points of the body and velocities. One number of each world is varied: a mass, a friction, a
restitution, an inertia, the first position or velocity of a body, or the pusher's velocity. Its derivative by the
backward pass is compared with central differences of four widths. Where these do not agree among themselves to within
0.3 %, or where the differences to the two sides differ, a contact opens, closes, begins to slide or touches with
another feature there: a kink, which has no derivative to compare with. Worlds with a step whose friction lags (see
`Trajectory.lagged`) are counted apart: there the solution, and so its derivative, is not exact.
"""

import argparse
import collections
import dataclasses
import json
import time
from collections.abc import Callable
from pathlib import Path

import numpy as np
import torch
from torch import Tensor

from benchmarks.contact_scenes import WORLDS, Scene, draw, objects
from benchmarks.results import write_json
from pinwm_drake.geometry.shapes import sphere
from pinwm_drake.physics.model import Model
from pinwm_drake.physics.parameters import Parameters
from pinwm_drake.physics.state import State, Trajectory
from pinwm_drake.physics.stepper import Stepper
from pinwm_drake.spatial.rotations import quaternion_exp, quaternion_multiply, quaternion_to_matrix

WIDTHS = (1e-4, 1e-5, 1e-6, 1e-7)  # of a number's scale
AGREES, RIGHT = 3e-3, 1e-2
FLIP_STEPS = 200
# Derivatives smaller than this are none: a pusher that misses has no friction.
LEAST = 1e-6
NUMBERS = ("mass", "inertia", "friction", "restitution", "position", "turn", "velocity", "pusher")


def flip(number: int, seed: int) -> Scene:
    """Batch of pokes high on an object that stands, at up to 2 m/s, 200 steps of 1/480 s."""
    g = np.random.default_rng([seed, number, 1])
    bodies = [body for body in (one[0] for one in objects() if len(one) == 1) if body.name in ("cube", "mug", "prism")]
    body = bodies[(number // 8) % len(bodies)]
    model = Model(bodies=[body], pusher=[sphere(0.01)], time_step=1.0 / 480.0)
    height = -min(float((piece.vertices[:, 2] - piece.radius).min()) for piece in body.pieces)
    reach = max(float(np.linalg.norm(piece.vertices[:, :2], axis=1).max()) for piece in body.pieces) + 0.015
    nominal = Parameters.nominal(model, num_worlds=WORLDS)
    pairs = nominal.friction.shape[1]
    yaw, angle = g.uniform(-np.pi, np.pi, (2, WORLDS))
    q = torch.zeros(WORLDS, 1, 4, dtype=torch.float64)
    q[:, 0, 0], q[:, 0, 3] = torch.tensor(np.cos(0.5 * yaw)), torch.tensor(np.sin(0.5 * yaw))
    p = torch.zeros(WORLDS, 1, 3, dtype=torch.float64)
    p[..., 2] = height
    away = np.column_stack([np.cos(angle), np.sin(angle)])
    start = np.column_stack([-reach * away, height + g.uniform(0.3, 0.8, WORLDS) * height])
    velocity = np.zeros((FLIP_STEPS, WORLDS, 6))
    velocity[:100, :, 3:5] = g.uniform(0.5, 2.0, WORLDS)[:, None] * away
    parameters = Parameters(
        nominal.mass,
        nominal.inertia,
        torch.tensor(g.uniform(0.2, 1.0, (WORLDS, pairs))),
        torch.tensor(g.uniform(0.0, 0.5, (WORLDS, pairs))),
    )
    identity = torch.tensor([[1.0, 0.0, 0.0, 0.0]] * WORLDS, dtype=torch.float64)
    state = State(q, p, torch.zeros(WORLDS, 1, 6, dtype=torch.float64), identity, torch.tensor(start))
    return Scene(f"flip of a {body.name}", model, parameters, state, torch.tensor(velocity), False)


@dataclasses.dataclass(frozen=True)
class Variation:
    """One number of each world, as a change s (W,) of what a rollout is given.

    Attributes:
        names: Of the number in each world.
        apply: Scene of a change; differentiable.
    """

    names: list[str]
    apply: Callable[[Tensor], tuple[Parameters, State, Tensor]]


def vary(scene: Scene, g: np.random.Generator) -> Variation:
    """Draws the number that is varied in each world, and its direction."""
    theta, state, W = scene.parameters, scene.state, WORLDS
    pairs, nb = theta.friction.shape[1], theta.mass.shape[1]
    body, pair = g.integers(nb, size=W), g.integers(pairs, size=W)
    choice = g.integers(len(NUMBERS), size=W)
    names = [NUMBERS[k] for k in choice]
    world = torch.arange(W)
    # A coefficient at the end of its range has a derivative to one side only.
    for w in range(W):
        if (names[w] == "friction" and float(theta.friction[w, pair[w]]) < 1e-2) or (
            names[w] == "restitution" and not 1e-2 < float(theta.restitution[w, pair[w]]) < 0.99
        ):
            names[w] = "position"
        if names[w] == "pusher" and not scene.model.arrays.num_kinematic:
            names[w] = "velocity"
    direction = torch.tensor(g.normal(size=(W, 6)))
    level = torch.tensor([1.0, 1.0, 0.0], dtype=torch.float64)

    def chosen(name: str, width: int, index: np.ndarray) -> Tensor:
        mask = torch.zeros(W, width, dtype=torch.float64)
        mask[world, torch.as_tensor(index)] = torch.tensor([float(one == name) for one in names], dtype=torch.float64)
        return mask

    masks = {name: chosen(name, pairs if name in ("friction", "restitution") else nb, pair if name in (
        "friction", "restitution") else body) for name in NUMBERS}  # fmt: skip

    # A stack whose faces are exactly aligned, or which falls freely with all gaps exactly 0, is at a kink.
    askew = torch.zeros(W, nb, 3, dtype=torch.float64)
    beside = torch.zeros(W, nb, 3, dtype=torch.float64)
    if nb > 1:
        askew[..., 2] = torch.tensor(g.uniform(-0.05, 0.05, (W, nb)))
        beside[..., :2] = torch.tensor(g.uniform(-0.002, 0.002, (W, nb, 2)))
        beside[..., 2] = torch.tensor(g.uniform(1e-4, 1e-3, (W, nb)).cumsum(1))
    state = dataclasses.replace(
        state, q_WB=quaternion_multiply(quaternion_exp(askew), state.q_WB), p_WB=state.p_WB + beside
    )

    def apply(s: Tensor) -> tuple[Parameters, State, Tensor]:
        scaled = {name: mask * s[:, None] for name, mask in masks.items()}
        varied = Parameters(
            theta.mass * (1.0 + scaled["mass"]),
            theta.inertia * (1.0 + scaled["inertia"][..., None, None]),
            theta.friction * (1.0 + scaled["friction"]),
            theta.restitution * (1.0 + scaled["restitution"]),
        )
        # Along the floor and about its normal where a body rests on it, so that contacts stay.
        turn = 0.3 * scaled["turn"][..., None] * torch.tensor([0.0, 0.0, 1.0], dtype=torch.float64)
        begun = State(
            quaternion_multiply(quaternion_exp(turn), state.q_WB),
            state.p_WB + 0.02 * scaled["position"][..., None] * (direction[:, None, :3] * level),
            state.V_WB + scaled["velocity"][..., None] * direction[:, None] * (state.V_WB.abs() + 0.1)
            * torch.tensor([0.0, 0.0, 1.0, 1.0, 1.0, 0.0], dtype=torch.float64),
            state.q_WP,
            state.p_WP,
        )  # fmt: skip
        faster = 1.0 + scaled["pusher"][:, 0]
        return varied, begun, scene.V_WP * faster[None, :, None]

    return Variation(names, apply)


def losses(trajectory: Trajectory, weights: Tensor) -> Tensor:
    """Loss of each world (W,), of the last frame."""
    p, R, V = trajectory.p_WB[-1], quaternion_to_matrix(trajectory.q_WB[-1]), trajectory.V_WB[-1]
    values = torch.cat([10.0 * p, R.flatten(-2), 0.1 * V], -1)
    return (values * weights).sum((-2, -1))


def compare(scene: Scene, seed: int, counts: dict[str, collections.Counter], worst: list[dict]) -> None:
    """Count the derivatives of a batch that are right, wrong, kinks or none, by scene and number."""
    g = np.random.default_rng([seed, 2])
    variation = vary(scene, g)
    weights = torch.tensor(g.normal(size=(WORLDS, len(scene.model.bodies), 18)))
    stepper = Stepper(scene.model, num_threads=1)
    every = len(scene.V_WP)

    def roll(s: Tensor) -> Trajectory:
        parameters, state, V_WP = variation.apply(s)
        return stepper.rollout(parameters, state, V_WP, record_every=every)

    def value(s: Tensor) -> Tensor:
        return losses(roll(s), weights)

    s = torch.zeros(WORLDS, dtype=torch.float64, requires_grad=True)
    (analytic,) = torch.autograd.grad(value(s).sum(), s)
    with torch.no_grad():
        ones = torch.ones(WORLDS, dtype=torch.float64)
        trajectory = roll(0.0 * ones)
        here, lagged = losses(trajectory, weights), trajectory.lagged
    assert lagged is not None
    with torch.no_grad():
        sides = torch.stack([torch.stack([value(w * ones) - here, here - value(-w * ones)]) / w for w in WIDTHS])
        differences = sides.mean(1)
    for w in range(WORLDS):
        d, a = differences[:, w].numpy(), float(analytic[w])
        size = max(np.abs(d).max(), abs(a))
        keys = (scene.name, variation.names[w], "all")
        if size < LEAST:
            for key in keys:
                counts[key]["none"] += 1
            continue
        apart = np.abs(np.diff(d)) / np.maximum(np.abs(d[1:]), np.abs(d[:-1]))
        best = int(np.argmin(apart))
        ahead, behind = sides[best : best + 2, :, w].numpy().T
        uneven = np.abs(ahead - behind).min() / size
        if not (apart[best] < AGREES and uneven < RIGHT):
            outcome, error = "kink", float("nan")
        else:
            # The width that is nearest to the backward pass, among those that agree.
            error = float(np.abs(d[best : best + 2] - a).min() / size)
            outcome = "right" if error < RIGHT else "wrong" if int(lagged[w]) == 0 else "lagged"
        for key in keys:
            counts[key][outcome] += 1
        if outcome == "wrong":
            worst.append({"scene": scene.name, "number": variation.names[w], "world": w, "error": error,
                          "analytic": a, "differences": d.tolist(), "seed": seed})  # fmt: skip


def main() -> None:
    """Run the comparison."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--samples", type=int, default=10_000)
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--out", type=Path)
    options = parser.parse_args()
    torch.set_num_threads(1)
    counts: dict[str, collections.Counter] = collections.defaultdict(collections.Counter)
    worst: list[dict] = []
    began = time.process_time()
    for number in range(-(-options.samples // WORLDS)):
        scene = flip(number, options.seed) if number % 8 == 7 else draw(number, options.seed)
        compare(scene, 1_000_003 * options.seed + number, counts, worst)
    for name in sorted(counts):
        count = counts[name]
        compared = count["right"] + count["wrong"] + count["lagged"]
        print(f"{name:40} {dict(count)} {100.0 * count['right'] / max(compared, 1):.2f} % right")
    for one in worst:
        print(json.dumps(one))
    print(f"{time.process_time() - began:.0f} CPU-s")
    write_json(options.out, seed=options.seed, counts=counts, wrong=worst)


if __name__ == "__main__":
    main()
