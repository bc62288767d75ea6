# SPDX-License-Identifier: MIT
"""Time of one step of random pokes on one core: pinwm_drake, forward and with its gradient, beside MuJoCo.

    python -m benchmarks.contact_speed --rounds 10

Objects are pushed and poked by a sphere in 32 worlds: a T-block, an L-block and a prism near the floor, a cube and the
shipped mug (standing and lying) up to their upper edge. Both engines have the same convex pieces, 65 of the mug. Ours
acts as a twin does, with a cylinder whose end is open before them; `--facets` leaves that out. MuJoCo has its defaults
(Newton's method, pyramidal cone) and its loop in C; its pusher is a body of a tonne on three slides.
"""

import argparse
import time
from dataclasses import dataclass, replace
from pathlib import Path

from benchmarks import timing

if __name__ == "__main__":
    timing.limit_threads(1)  # before numba and torch are imported

import mujoco
import numpy as np
import torch

from benchmarks.contact_scenes import l_block, prism, solid
from benchmarks.results import markdown, write_json
from benchmarks.scenes.mujoco_xml import poked_model, pusher
from pinwm_drake.geometry.convex import t_block
from pinwm_drake.geometry.primitive import acting_pieces
from pinwm_drake.geometry.shapes import box, sphere
from pinwm_drake.geometry.stored_pieces import mesh_pieces, mesh_primitives
from pinwm_drake.models import object_model
from pinwm_drake.physics.model import Body, Model
from pinwm_drake.physics.parameters import Parameters
from pinwm_drake.physics.state import State
from pinwm_drake.physics.stepper import Stepper
from pinwm_drake.spatial.rotations import quaternion_to_matrix

WORLDS, SECONDS, RADIUS = 32, 0.5, 0.01
BARS = {"t_block": 0.45, "cube": 0.55, "prism": 0.5, "l_block": 0.45, "standing mug": 0.6, "lying mug": 0.5}
BACKWARD_BAR = 1.2


@dataclass(frozen=True)
class Pokes:
    """Pokes of one object: poses (W, 4), (W, 3), pusher starts (W, 3), velocities (W, 3) and steps until they stop."""

    body: Body
    acting: Body  # the same as a twin has it
    rate: int
    q: np.ndarray
    p: np.ndarray
    start: np.ndarray
    velocity: np.ndarray
    stop: np.ndarray
    friction: np.ndarray  # (W, 2), of floor and pusher

    @property
    def steps(self) -> int:
        """Steps of a rollout."""
        return round(SECONDS * self.rate)


def draw(name: str, rate: int, seed: int, facets: bool = False) -> Pokes:
    """Random pokes of an object."""
    g = np.random.default_rng(seed)
    mug = object_model("mug").mesh_path
    pieces = {
        "t_block": t_block,
        "l_block": l_block,
        "cube": lambda: [box((0.06,) * 3)],
        "prism": lambda: [prism(6, 0.04, 0.05)],
    }.get(name, lambda: mesh_pieces(mug))()
    pokes, round_ = name in ("cube", "standing mug", "lying mug"), name.endswith("mug") and not facets
    body = solid(name.replace(" ", "_"), list(pieces), 0.5)
    centre = pieces[0].vertices[0] - body.pieces[0].vertices[0]
    as_round = acting_pieces(pieces, mesh_primitives(mug) if round_ else ())
    acting = replace(body, pieces=[replace(piece, vertices=piece.vertices - centre) for piece in as_round])
    yaw = g.uniform(-np.pi, np.pi, WORLDS)
    q = np.stack([np.cos(0.5 * yaw), 0 * yaw, 0 * yaw, np.sin(0.5 * yaw)], -1)
    if name == "lying mug":
        half = np.sqrt(0.5)
        roll = g.uniform(-np.pi, np.pi, WORLDS)
        q = half * np.stack([np.cos(roll), np.sin(roll), np.cos(roll), -np.sin(roll)], -1)
        q /= np.linalg.norm(q, axis=1, keepdims=True)
    R = quaternion_to_matrix(torch.from_numpy(q)).numpy()
    points = np.concatenate([piece.vertices for piece in body.pieces])
    z, x = points @ R[:, 2].T, points @ R[:, 0].T
    low, high, reach = -z.min(0), z.max(0) - z.min(0), -x.min(0)
    p = np.stack([0 * low, 0 * low, low + 1e-6], -1)
    speed = g.uniform(0.5, 1.0, WORLDS) if pokes else g.uniform(0.05, 0.3, WORLDS)
    height = high * g.uniform(0.5, 0.95, WORLDS) if pokes else 0.4 * high
    start = np.stack([-reach - RADIUS - 0.002, g.uniform(-0.4, 0.4, WORLDS) * reach, height], -1)
    velocity = np.stack([speed, 0 * speed, g.choice([0.0, 0.3, -0.3], WORLDS) * pokes], -1)
    stop = (g.uniform(0.2, 0.8, WORLDS) * SECONDS * rate).astype(int)
    friction = np.stack([g.uniform(0.1, 0.5, WORLDS), g.uniform(0.3, 0.9, WORLDS)], -1)
    return Pokes(body, acting, rate, q, p, start, velocity, stop, friction)


class Ours:
    """Pokes in pinwm_drake."""

    def __init__(self, pokes: Pokes) -> None:
        self.model = Model(bodies=[pokes.acting], pusher=[sphere(RADIUS)], time_step=1.0 / pokes.rate)
        self.stepper = Stepper(self.model, num_threads=1)
        theta = Parameters.nominal(self.model, num_worlds=WORLDS)
        order = [self.model.pair_names.index(f"{pokes.body.name}-{other}") for other in ("floor", "pusher")]
        friction = theta.friction.clone()
        friction[:, order] = torch.from_numpy(pokes.friction)
        self.theta = Parameters(theta.mass, theta.inertia, friction, theta.restitution)
        self.state = State.at_rest(
            self.model,
            WORLDS,
            q_WB=torch.from_numpy(pokes.q)[:, None],
            p_WB=torch.from_numpy(pokes.p)[:, None],
            p_WP=torch.from_numpy(pokes.start),
        )
        self.V = torch.zeros(pokes.steps, WORLDS, 6, dtype=torch.float64)
        for w in range(WORLDS):
            self.V[: pokes.stop[w], w, 3:] = torch.from_numpy(pokes.velocity[w])

    def forward(self) -> torch.Tensor:
        """Roll out; final positions (W, 3)."""
        every = len(self.V)
        return self.stepper.rollout(self.theta, self.state, self.V, record_every=every).p_WB[-1, :, 0]

    def forward_backward(self) -> None:
        """Roll out and pull a gradient back to friction and the pusher's velocities."""
        friction, V = self.theta.friction.clone().requires_grad_(), self.V.clone().requires_grad_()
        theta = Parameters(self.theta.mass, self.theta.inertia, friction, self.theta.restitution)
        self.stepper.rollout(theta, self.state, V, record_every=len(V)).p_WB[-1].sum().backward()


class Theirs:
    """Pokes in MuJoCo, one world after the other."""

    def __init__(self, pokes: Pokes) -> None:
        self.pokes, body = pokes, pokes.body
        solid = body.mass, np.zeros(3), np.diag(body.inertia)
        self.model = poked_model(body.pieces, solid, pusher("sphere", RADIUS, 0.0), 1.0 / pokes.rate)
        self.data = mujoco.MjData(self.model)
        self.ends = np.zeros((WORLDS, 3))

    def forward(self) -> None:
        """Roll all worlds out."""
        model, data, pokes = self.model, self.data, self.pokes
        for w in range(WORLDS):
            mujoco.mj_resetData(model, data)
            model.geom("floor").friction[0], model.geom("pusher").friction[0] = pokes.friction[w]
            data.qpos[:3], data.qpos[3:7], data.qpos[7:10] = pokes.p[w], pokes.q[w], pokes.start[w]
            data.qvel[6:9] = pokes.velocity[w]
            mujoco.mj_step(model, data, nstep=int(pokes.stop[w]))
            data.qvel[6:9] = 0.0
            mujoco.mj_step(model, data, nstep=pokes.steps - int(pokes.stop[w]))
            self.ends[w] = data.qpos[:3]


def main() -> None:
    """Time all objects."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--rounds", type=int, default=10)
    parser.add_argument("--rate", type=int, default=480, help="Hz")
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--objects", nargs="+", choices=list(BARS), default=list(BARS))
    parser.add_argument("--facets", action="store_true", help="mugs as their mesh")
    parser.add_argument("--out", type=Path)
    options = parser.parse_args()
    torch.set_num_threads(1)
    found = {}
    header = "object | ours, µs a step | MuJoCo | forward / MuJoCo (bar) | forward and backward / MuJoCo | ends apart"
    print("\n".join(markdown(header, [])))
    for name in options.objects:
        pokes = draw(name, options.rate, options.seed, options.facets)
        ours, theirs = Ours(pokes), Theirs(pokes)
        units = WORLDS * pokes.steps
        cases = {
            "forward": timing.Case(ours.forward, units=units),
            "both": timing.Case(ours.forward_backward, units=units),
            "mujoco": timing.Case(theirs.forward, units=units),
        }
        samples = timing.interleave(cases, options.rounds, warmup=1, clock=time.process_time)
        apart = float(np.median(np.linalg.norm(ours.forward().numpy() - theirs.ends, axis=1)))
        ratios = {case: samples[case].over(samples["mujoco"])["median"] for case in ("forward", "both")}
        times = {case: samples[case].summary()["median"] for case in cases}
        found[name] = {"microseconds": times, "over_mujoco": ratios, "ends_apart": apart}
        print(
            f"| {name} | {times['forward']:.1f} | {times['mujoco']:.1f} | {ratios['forward']:.2f} ({BARS[name]}) "
            f"| {ratios['both']:.2f} ({BACKWARD_BAR}) | {1e3 * apart:.1f} mm |",
            flush=True,
        )
    write_json(options.out, rounds=options.rounds, rate=options.rate, seed=options.seed, objects=found)


if __name__ == "__main__":
    main()
