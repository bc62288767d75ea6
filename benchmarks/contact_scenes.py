# SPDX-License-Identifier: MIT
"""Random contact scenes: does every step find its solution, keep its energy and stay out of the floor?

    python -m benchmarks.contact_scenes --scenes 10000

A scene is a model (a body of 1 to 64 convex pieces, or a stack of three), parameters (friction 0 to 2, restitution 0 to
1), and a motion: thrown without a pusher, or at rest and pushed or pressed at up to 3 m/s. Counted are steps that fail,
states that are no numbers, steps in which the energy of a scene without a pusher rises by more than 1e-3 of the first,
and points of a body that are more than 0.2 mm below the floor. Heights and energies are computed here from shapes and
states alone.
"""

import argparse
import collections
import functools
import time
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import torch

from benchmarks.results import write_json
from pinwm_drake.errors import SolverError
from pinwm_drake.geometry.convex import hollow_mug, t_block
from pinwm_drake.geometry.pieces import CYLINDER, ConvexPiece
from pinwm_drake.geometry.shapes import box, capsule, convex_hull, cylinder, sphere
from pinwm_drake.physics.model import Body, Model
from pinwm_drake.physics.parameters import Parameters
from pinwm_drake.physics.state import State
from pinwm_drake.physics.stepper import Stepper
from pinwm_drake.spatial.rotations import quaternion_to_matrix

WORLDS, STEPS = 16, 60  # of a batch
MOST_RISE, MOST_DEPTH = 1e-3, 2e-4  # of the first energy; m
EYE = np.eye(3)


def solid(name: str, pieces: list[ConvexPiece], mass: float = 0.5) -> Body:
    """Body of pieces, with the inertia of the box around them about its centre, moved there; its lines press evenly."""
    points = np.concatenate([[low, high] for low, high in map(bounds, pieces)])
    low, high = points.min(0), points.max(0)
    centre, (x, y, z) = 0.5 * (low + high), high - low
    moved = [ConvexPiece(piece.kind, piece.vertices - centre, piece.radius, piece.faces) for piece in pieces]
    inertia = mass / 12.0 * np.diag([y * y + z * z, x * x + z * z, x * x + y * y])
    return Body(name, moved, mass, inertia, even_lines=True)


def bounds(piece: ConvexPiece) -> tuple[np.ndarray, np.ndarray]:
    """Corners of a box around a piece."""
    return piece.vertices.min(0) - piece.radius, piece.vertices.max(0) + piece.radius


def prism(corners: int, radius: float, height: float) -> ConvexPiece:
    """Regular prism."""
    angles = 2.0 * np.pi * np.arange(corners) / corners
    ring = np.column_stack([radius * np.cos(angles), radius * np.sin(angles)])
    return convex_hull(np.vstack([np.column_stack([ring, np.full(corners, z)]) for z in (-0.5 * height, 0.5 * height)]))


def l_block() -> list[ConvexPiece]:
    """Two bars at a right angle."""
    return [box((0.12, 0.04, 0.05)), box((0.04, 0.08, 0.05), (EYE, np.array([-0.04, 0.06, 0.0])))]


def rock(generator: np.random.Generator) -> ConvexPiece:
    """Hull of random points."""
    return convex_hull(0.04 * generator.normal(size=(12, 3)))


@functools.cache
def objects() -> list[list[Body]]:
    """Bodies of the scenes, lowest first."""
    generator = np.random.default_rng(0)
    mug = {n: solid("mug", hollow_mug(segments=n)) for n in (16, 63)}
    single = [
        solid("cube", [box((0.06,) * 3)]),
        solid("plate", [box((0.12, 0.08, 0.01))]),
        solid("l_block", l_block()),
        solid("t_block", t_block()),
        mug[16],
        mug[63],
        solid("prism", [prism(6, 0.04, 0.05)]),
        solid("cylinder", [cylinder(0.03, 0.08)]),
        solid("coin", [cylinder(0.03, 0.004)]),
        solid("capsule", [capsule(0.02, 0.06)]),
        solid("ball", [sphere(0.03)]),
        *(solid("rock", [rock(generator)]) for _ in range(2)),
    ]
    stack = [solid(name, [box((0.06, 0.06, 0.04))]) for name in ("low", "middle", "top")]
    mixed = [solid("low", t_block()), solid("middle", [cylinder(0.03, 0.04)]), solid("top", [box((0.05,) * 3)])]
    return [*([body] for body in single), stack, mixed]


PUSHERS: dict[str, Callable[[], list[ConvexPiece]]] = {
    "sphere": lambda: [sphere(0.01)],
    "capsule": lambda: [capsule(0.01, 0.04)],
    "cylinder": lambda: [cylinder(0.01, 0.06)],
    "hull": lambda: [prism(32, 0.01, 0.06)],
}


@dataclass(frozen=True)
class Scene:
    """A batch of worlds of one model.

    Attributes:
        name: Of the bodies, the pusher and the motion.
        model: The model.
        parameters: Of all worlds.
        state: Of all worlds.
        V_WP: (T, W, 6), of the pusher.
        thrown: Whether no pusher takes part.
    """

    name: str
    model: Model
    parameters: Parameters
    state: State
    V_WP: torch.Tensor
    thrown: bool


def heights(body: Body, q: torch.Tensor, p: torch.Tensor) -> torch.Tensor:
    """Height of the lowest point of a body at poses q (..., 4), p (..., 3)."""
    R, lowest = quaternion_to_matrix(q), torch.full(p.shape[:-1], torch.inf, dtype=p.dtype)
    for piece in body.pieces:
        z = (R[..., 2, :] @ torch.as_tensor(piece.vertices).T + p[..., 2:]).amin(-1)
        if piece.kind == CYLINDER:
            axis = torch.as_tensor(piece.vertices[1] - piece.vertices[0])
            cosine = R[..., 2, :] @ (axis / axis.norm())
            z = z - piece.radius * (1.0 - cosine * cosine).clamp_min(0.0).sqrt()
        else:
            z = z - piece.radius
        lowest = torch.minimum(lowest, z)
    return lowest


def energies(model: Model, parameters: Parameters, q: torch.Tensor, p: torch.Tensor, V: torch.Tensor) -> torch.Tensor:
    """Kinetic and potential energy (..., W) of frames (..., W, nb, n)."""
    w = (quaternion_to_matrix(q).mT @ V[..., :3, None])[..., 0]
    spin = 0.5 * (w * (parameters.inertia @ w[..., None])[..., 0]).sum(-1)
    motion = 0.5 * parameters.mass * (V[..., 3:] ** 2).sum(-1)
    height = -parameters.mass * (p @ torch.as_tensor(model.gravity, dtype=p.dtype))
    return (spin + motion + height).sum(-1)


def draw(number: int, seed: int, steps: int = STEPS) -> Scene:
    """Draws a batch of scenes of some steps."""
    g = np.random.default_rng([seed, number])
    bodies = objects()
    chosen = bodies[number % len(bodies)]
    thrown = bool((number // len(bodies)) % 2)
    kind = list(PUSHERS)[int(g.integers(len(PUSHERS)))]
    rate = g.choice([240, 480, 960])
    model = Model(
        bodies=chosen,
        pusher=None if thrown else PUSHERS[kind](),
        time_step=1.0 / float(rate),
    )
    W, nb = WORLDS, len(chosen)
    nominal = Parameters.nominal(model, num_worlds=W)
    pairs = nominal.friction.shape[1]
    parameters = Parameters(
        nominal.mass,
        nominal.inertia,
        torch.tensor(g.uniform(0.0, 2.0, (W, pairs)) * g.choice([0.0, 0.25, 1.0], (W, 1))),
        torch.tensor(g.uniform(0.0, 1.0, (W, pairs)) * g.choice([0.0, 1.0], (W, 1))),
    )
    q = np.zeros((W, nb, 4))
    q[..., 0] = 1.0
    V = np.zeros((W, nb, 6))
    if nb == 1:
        if thrown or g.random() < 0.5:
            q = g.normal(size=(W, 1, 4))
        else:
            yaw = g.uniform(-np.pi, np.pi, W)
            q[:, 0, 0], q[:, 0, 3] = np.cos(0.5 * yaw), np.sin(0.5 * yaw)
        q /= np.linalg.norm(q, axis=-1, keepdims=True)
        if thrown:
            V = g.normal(size=(W, 1, 6)) * np.array([5.0, 5.0, 5.0, 1.0, 1.0, 1.0])
    tensors = torch.tensor(q), torch.tensor(V)
    p = torch.zeros(W, nb, 3, dtype=torch.float64)
    top = torch.zeros(W, dtype=torch.float64)
    for b, body in enumerate(chosen):
        p[:, b, 2] = top - heights(body, tensors[0][:, b], p[:, b])
        upper = max(float(bounds(piece)[1][2]) for piece in body.pieces)
        top = p[:, b, 2] + upper
    if thrown:
        p[..., 2] += float(g.uniform(0.0, 0.02))
    size = 0.5 * float(max(np.abs(np.stack(bounds(piece))).max() for body in chosen for piece in body.pieces))
    velocity = np.zeros((steps, W, 6))
    start = np.zeros((W, 3))
    if not thrown:
        press = g.random(W) < 0.3
        angle, speed = g.uniform(-np.pi, np.pi, W), g.uniform(0.05, 3.0, W)
        reach = 4.0 * size + 0.05
        start[:, 0], start[:, 1] = -reach * np.cos(angle), -reach * np.sin(angle)
        start[:, 2] = g.uniform(0.04, 0.04 + float(top.max()), W)
        start[press] = np.column_stack([g.uniform(-size, size, (W, 2)), np.full(W, float(top.max()) + 0.2)])[press]
        aim = g.uniform(-0.5 * size, 0.5 * size, (W, 2))
        velocity[..., 3] = np.where(press, 0.0, speed * np.cos(angle))
        velocity[..., 4] = np.where(press, 0.0, speed * np.sin(angle))
        velocity[..., 5] = np.where(press, -speed, 0.0)
        start[:, :2] += aim
        # What is far away would only be waited for: the pusher begins near.
        lead = np.maximum(reach - 2.5 * size - 0.02, 0.0)
        start[:, 0] += np.where(press, 0.0, lead * np.cos(angle))
        start[:, 1] += np.where(press, 0.0, lead * np.sin(angle))
        start[:, 2] = np.where(press, float(top.max()) + 0.05, start[:, 2])
    state = State(
        tensors[0],
        p,
        tensors[1],
        torch.tensor([[1.0, 0.0, 0.0, 0.0]] * W, dtype=torch.float64),
        torch.tensor(start),
    )
    names = "+".join(body.name for body in chosen)
    return Scene(f"{names}, {'thrown' if thrown else kind}", model, parameters, state, torch.tensor(velocity), thrown)


def judge(scene: Scene, counts: dict[str, collections.Counter]) -> list[str]:
    """Faults of a batch, counted by name and kind."""
    count = counts.setdefault(scene.name, collections.Counter())
    count["worlds"] += WORLDS
    try:
        trajectory = Stepper(scene.model, num_threads=1).rollout(scene.parameters, scene.state, scene.V_WP)
    except SolverError as error:
        count["failed"] += len(error.worlds)
        return [str(error)]
    faults = []
    q, p, V = trajectory.q_WB, trajectory.p_WB, trajectory.V_WB
    if not all(bool(torch.isfinite(value).all()) for value in (q, p, V)):
        count["no numbers"] += 1
        return ["no numbers"]
    lowest = torch.stack([heights(body, q[:, :, b], p[:, :, b]) for b, body in enumerate(scene.model.bodies)], -1)
    assert trajectory.jams is not None
    assert trajectory.lagged is not None
    jammed = trajectory.jams > 0
    count["jammed"] += int(jammed.sum())
    count["steps with lagged friction"] += int(trajectory.lagged.sum())
    deep = (lowest.amin(-1) < -MOST_DEPTH).any(0) & ~jammed
    count["deep"] += int(deep.sum())
    if deep.any():
        faults.append(f"world {int(deep.nonzero()[0])}: {1e3 * float(lowest[:, deep].min()):.3f} mm")
    if scene.thrown:
        E = energies(scene.model, scene.parameters, q, p, V)
        rise = ((E[1:] - E[:-1]) / E[0]).amax(0)
        count["gained"] += int((rise > MOST_RISE).sum())
        if float(rise.max()) > MOST_RISE:
            faults.append(f"world {int(rise.argmax())}: energy rises by {float(rise.max()):.2e} in a step")
    return faults


def main() -> None:
    """Run the scenes."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--scenes", type=int, default=10_000)
    parser.add_argument("--first", type=int, default=0, help="number of the first batch")
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--out", type=Path)
    parser.add_argument("--verbose", action="store_true")
    options = parser.parse_args()
    torch.set_num_threads(1)
    counts: dict[str, collections.Counter] = {}
    began = time.process_time()
    for number in range(options.first, options.first + -(-options.scenes // WORLDS)):
        scene = draw(number, options.seed)
        for fault in judge(scene, counts):
            if options.verbose:
                print(f"{number} {scene.name}: {fault}", flush=True)
    total = sum(counts.values(), collections.Counter())
    for name in sorted(counts):
        print(f"{name:40}", dict(counts[name]))
    print(f"in all: {dict(total)}, {time.process_time() - began:.0f} CPU-s")
    write_json(options.out, seed=options.seed, counts=counts)


if __name__ == "__main__":
    main()
