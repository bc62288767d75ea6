# SPDX-License-Identifier: MIT
"""Contact of any object: no step without a solution, no ghosts, no jams that throw things, derivatives of rims."""

import collections

import numpy as np
import pytest
import torch

from benchmarks.contact_gradients import compare
from benchmarks.contact_scenes import draw, judge
from pinwm_drake.geometry.convex import hollow_mug
from pinwm_drake.geometry.shapes import box, cylinder, sphere
from pinwm_drake.physics.diagnose import inspect
from pinwm_drake.physics.model import Body, Model
from pinwm_drake.physics.parameters import Parameters
from pinwm_drake.physics.state import State
from pinwm_drake.physics.stepper import Stepper
from pinwm_drake.spatial.rotations import quaternion_to_matrix
from tests.physics.scenes import cube

EDGE = 0.06
BATCHES, BATCH_STEPS = 625, 15  # of 16 worlds


def pusher_velocity(steps, worlds, velocity):
    V = torch.zeros(steps, worlds, 6, dtype=torch.float64)
    V[..., 3:] = torch.tensor(velocity, dtype=torch.float64)
    return V


# `python -m benchmarks.contact_scenes --scenes 1000000` runs a million.
@pytest.mark.nightly
def test_ten_thousand_scenes_all_have_solutions():
    counts: dict[str, collections.Counter] = {}
    for number in range(BATCHES):
        judge(draw(number, seed=1, steps=BATCH_STEPS), counts)
    total = sum(counts.values(), collections.Counter())
    assert total["worlds"] == 10_000
    assert (total["failed"], total["no numbers"], total["gained"], total["deep"]) == (0, 0, 0, 0)


# `python -m benchmarks.contact_gradients` compares ten thousand.
@pytest.mark.parametrize("scenes", [range(0, 30, 4), pytest.param(range(60), marks=pytest.mark.nightly)], ids=len)
def test_derivatives_of_random_scenes_agree_with_differences(scenes):
    counts: dict[str, collections.Counter] = collections.defaultdict(collections.Counter)
    for number in scenes:
        compare(draw(number, seed=5), number, counts, [])
    total = counts["all"]
    compared = total["right"] + total["wrong"] + total["lagged"]
    assert compared >= 500 * len(scenes) // 60
    assert total["right"] >= 0.99 * compared


# A polytope that outgrew its table, a wedge whose friction is stiffer than numbers resolve, and a stack that falls, in
# which a last step of Newton's method left the solution.
@pytest.mark.parametrize(("number", "seed"), [(4934, 7), (20402, 14), (35069, 14)], ids=["polytope", "wedge", "stack"])
def test_scenes_that_were_wrong_once_are_right(number, seed):
    counts: dict[str, collections.Counter] = {}
    judge(draw(number, seed=seed), counts)
    total = sum(counts.values(), collections.Counter())
    assert (total["failed"], total["gained"]) == (0, 0)


def test_a_standing_mug_that_is_poked_near_its_rim():
    # Sixteen corners in one plane: many sets of contacts are nearly right.
    generator = np.random.default_rng(0)
    inertia = 0.3 * np.diag([0.0013, 0.0013, 0.0013])
    model = Model(bodies=[Body("mug", hollow_mug(), 0.3, inertia)], pusher=[sphere(0.01)])
    lowest = -min(float(piece.vertices[:, 2].min()) for piece in model.bodies[0].pieces)
    worlds, steps = 60, 120
    yaw = generator.uniform(-np.pi, np.pi, worlds)
    q = np.stack([np.cos(yaw / 2), 0 * yaw, 0 * yaw, np.sin(yaw / 2)], -1)[:, None]
    state = State.at_rest(
        model,
        worlds,
        q_WB=torch.tensor(q),
        p_WB=(0.0, 0.0, lowest + 1e-6),
        p_WP=torch.tensor(
            np.stack(
                [
                    np.full(worlds, -0.052),
                    generator.uniform(-0.01, 0.01, worlds),
                    generator.uniform(0.06, 0.08, worlds),
                ],
                -1,
            )
        ),
    )
    V = pusher_velocity(steps, worlds, (0.0, 0.0, 0.0))
    V[:50, :, 3] = torch.tensor(generator.uniform(0.5, 1.0, worlds))
    theta = Parameters.nominal(model, friction_floor=0.3, friction_pusher=0.7, num_worlds=worlds)
    trajectory = Stepper(model).rollout(theta, state, V)
    assert torch.isfinite(trajectory.p_WB).all()


@pytest.mark.parametrize("clearance", [2e-4, 1e-3])
def test_what_passes_over_an_edge_does_not_hit_it(clearance):
    worlds, rate = 8, 240
    model = Model(bodies=[cube(edge=EDGE, mass=0.5)], pusher=[sphere(0.01)], time_step=1 / rate)
    start = torch.zeros(worlds, 3, dtype=torch.float64)
    start[:, 0] = -0.06 - torch.arange(worlds) / (worlds * rate)  # phases of a step
    start[:, 1], start[:, 2] = 0.001, EDGE + 0.01 + clearance
    state = State.at_rest(model, worlds, p_WB=(0.0, 0.0, EDGE / 2), p_WP=start)
    theta = Parameters.nominal(model, friction_floor=0.3, friction_pusher=0.7, num_worlds=worlds)
    trajectory = Stepper(model).rollout(theta, state, pusher_velocity(36, worlds, (1.0, 0.0, 0.0)))
    assert trajectory.V_WB.abs().max() < 1e-6


def test_what_flies_into_a_thin_plate_hits_it():
    plate = Body("plate", [box((0.1, 0.1, 0.001))], 0.05, 0.05 / 12 * 0.01 * np.diag([1.0, 1.0, 2.0]))
    ball = Body("ball", [sphere(0.003)], 0.001, 0.4 * 0.001 * 9e-6 * np.eye(3))
    model = Model(bodies=[ball, plate], gravity=(0, 0, 0), floor_height=None)
    state = State.at_rest(
        model,
        p_WB=torch.tensor([[0.01, 0.02, 0.1], [0.0, 0.0, 0.0]]),
        V_WB=torch.tensor([[0.0, 0.0, 0.0, 0.0, 0.0, -30.0], [0.0] * 6]),
    )
    trajectory = Stepper(model).rollout(Parameters.nominal(model), state, pusher_velocity(20, 1, (0.0, 0.0, 0.0)))
    from_plate = trajectory.p_WB[:, 0, 0] - trajectory.p_WB[:, 0, 1]
    from_plate = (quaternion_to_matrix(trajectory.q_WB[:, 0, 1]).mT @ from_plate[..., None])[..., 0]
    assert from_plate[:, :2].abs().max() < 0.05
    assert from_plate[:, 2].min() > 0.0


@pytest.mark.parametrize("offset", [0.001, 0.02])
def test_a_pusher_that_presses_a_cube_on_the_floor_is_jammed_and_throws_nothing(offset):
    model = Model(bodies=[cube(edge=EDGE, mass=0.5)], pusher=[sphere(0.01)])
    theta = Parameters.nominal(model, friction_floor=0.3, friction_pusher=0.7)
    state = State.at_rest(model, p_WB=(0.0, 0.0, EDGE / 2), p_WP=(offset, 0.0005, EDGE + 0.0105))
    V = pusher_velocity(48, 1, (0.0, 0.0, -0.1))
    trajectory = Stepper(model).rollout(theta, state, V)
    moved = (trajectory.p_WB[1:] - trajectory.p_WB[:-1])[:, 0, 0]
    jump = (moved - trajectory.V_WB[1:, 0, 0, 3:] * model.time_step).norm(dim=-1)
    assert jump.max() < 2e-4
    assert trajectory.jams[0] > 30
    for step in (5, 20, 40):
        impulse = inspect(model, theta, trajectory.frame(step), V[step]).impulse_W[-1]
        assert np.abs(impulse).max() < 1.01 * model.pusher_force * model.time_step
    # Where nothing is behind, the same pusher pushes.
    free = State.at_rest(model, p_WB=(0.0, 0.0, EDGE / 2), p_WP=(-0.041, 0.0005, 0.03))
    pushed = Stepper(model).rollout(theta, free, pusher_velocity(48, 1, (0.1, 0.0, 0.0)))
    assert pushed.jams[0] == 0
    assert pushed.p_WB[-1, 0, 0, 0] > 0.015


@pytest.mark.parametrize("backend", ["numba", "torch"])
def test_a_cap_over_an_edge_has_the_derivative_of_its_crossings(backend):
    # Two crossings of rim and edges beside a corner: they slide along the edges with the cap.
    model = Model(
        bodies=[cube(edge=EDGE, mass=0.5)], pusher=[cylinder(0.01, 0.04)], floor_height=None, gravity=(0, 0, 0)
    )
    theta = Parameters.nominal(model)
    q = torch.tensor([[0.9999981027093582, 0.0010867498485229471, -0.0008155755213561371, -0.0013958470617034264]])
    q = q.double() / q.double().norm()
    p = torch.tensor([[0.0347798555911035, 0.0371277594978461, 0.0501]], dtype=torch.float64)
    rest = State.at_rest(model)

    def speed(shift):
        state = State(rest.q_WB, rest.p_WB, rest.V_WB, q, p + shift)
        return Stepper(model, backend).step(theta, state, pusher_velocity(1, 1, (0.0, 0.0, -0.2))[0]).V_WB[0, 0, 1]

    shift = torch.zeros(1, 3, dtype=torch.float64, requires_grad=True)
    speed(shift).backward()
    for axis in range(3):
        step = torch.zeros(1, 3, dtype=torch.float64)
        step[0, axis] = 1e-7
        difference = float((speed(step) - speed(-step)).detach()) / 2e-7
        assert float(shift.grad[0, axis]) == pytest.approx(difference, rel=1e-2, abs=1e-3)
