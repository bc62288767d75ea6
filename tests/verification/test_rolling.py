# SPDX-License-Identifier: MIT
"""Rolling and tipping against closed forms: rimless wheels, rocking blocks, and what is round."""

import math

import numpy as np
import pytest
import torch
import trimesh
from scipy.integrate import solve_ivp

from pinwm_drake.geometry.patch import FACES_POINTS, PATCH_POINTS, supporting_points
from pinwm_drake.geometry.shapes import box, convex_hull, cylinder, sphere
from pinwm_drake.physics.model import Body, Model
from pinwm_drake.physics.state import State
from pinwm_drake.physics.stepper import Stepper
from tests.physics.scenes import box_inertia, energy, nominal, run

G = 9.81
RADIUS, INERTIA = 0.04, 0.0013  # m, kg m^2 about the axis, of 1 kg
SECONDS, RATE = 0.5, 240


def rimless_wheel(sides, speed):
    """Speed of a rimless wheel after half a second, rad/s, that begins on one edge with a face on the floor.

    It turns about each edge as an inverted pendulum and keeps (I + m R^2 cos d) / (I + m R^2) of its speed at the next.
    """
    d, about_edge = 2 * math.pi / sides, INERTIA + RADIUS**2
    kept, pull = (INERTIA + RADIUS**2 * math.cos(d)) / about_edge, G * RADIUS / about_edge

    def ahead(_, y):
        return y[0] - d / 2

    def behind(_, y):
        return y[0] + d / 2

    ahead.terminal, ahead.direction, behind.terminal, behind.direction = True, 1, True, -1
    t, state = 0.0, [-d / 2, speed]
    while True:
        arc = solve_ivp(
            lambda _, y: (y[1], pull * math.sin(y[0])),
            (t, SECONDS), state, "DOP853", events=(ahead, behind), rtol=1e-11, atol=1e-12,
        )  # fmt: skip
        t, (angle, turn) = arc.t[-1], arc.y[:, -1]
        if arc.status == 0:
            return turn
        state = [-math.copysign(d / 2, angle), kept * turn]


def wheel(sides, rate=RATE):
    corners = 2 * math.pi * (np.arange(sides) + 0.5) / sides
    ring = RADIUS * np.stack([np.sin(corners), 0 * corners, -np.cos(corners)], -1)
    prism = convex_hull(np.concatenate([ring + np.array([0, y, 0]) for y in (-0.025, 0.025)]))
    body = Body("wheel", [prism], 1.0, np.diag([0.8 * INERTIA, INERTIA, 0.8 * INERTIA]))
    return Model(bodies=[body], time_step=1 / rate)


def rolled(sides, speeds, heading):
    """Speeds after half a second of wheels that roll in a direction."""
    model, worlds, d = wheel(sides), len(speeds), 2 * math.pi / sides
    along, axis = (
        torch.tensor([math.cos(a), math.sin(a), 0.0], dtype=torch.float64) for a in (heading, heading + math.pi / 2)
    )
    up = torch.tensor([0.0, 0.0, 1.0], dtype=torch.float64)
    w = torch.as_tensor(speeds).double()[:, None] * axis
    edge = RADIUS * (math.sin(d / 2) * along - math.cos(d / 2) * up)
    V = torch.cat([w, -torch.linalg.cross(w, edge.expand_as(w))], -1)[:, None]
    q = (math.cos(heading / 2), 0.0, 0.0, math.sin(heading / 2))
    state = State.at_rest(model, worlds, q_WB=q, p_WB=(0.0, 0.0, RADIUS * math.cos(d / 2)), V_WB=V)
    parameters = nominal(model, friction_floor=3.0, num_worlds=worlds)
    frames = run(Stepper(model), parameters, state, SECONDS)
    w = frames.V_WB[-1, :, 0, :3]
    assert float((w - (w @ axis)[:, None] * axis).abs().max()) < 1e-9
    rise = torch.stack([energy(model, parameters, frames.frame(i)) for i in range(frames.num_frames)]).diff(dim=0)
    assert float(rise.max()) < 1e-5  # second order: 3 thousandths of the wheel's smallest energy of motion
    return (w @ axis).numpy()


@pytest.mark.parametrize("heading", [0.0, 0.7])
@pytest.mark.parametrize(
    ("sides", "speeds", "off"),
    [
        (64, (2.0, 4.0, 6.0, 8.0), 4e-4),
        (16, (2.75, 4.0, 6.0, 8.0), 3e-3),
        (8, (6.25, 7.0, 8.0), 4e-3),
        (8, (6.0,), 6e-3),
    ],
)
def test_a_rimless_wheel_rolls_as_its_closed_form(sides, speeds, off, heading):
    # Slower ones come nearly to rest over an edge, where a thousandth of the speed decides which way they fall.
    expected = np.array([rimless_wheel(sides, speed) for speed in speeds])
    np.testing.assert_allclose(rolled(sides, speeds, heading), expected, rtol=off)


def test_the_speed_of_a_wheel_depends_on_its_first_one_as_the_closed_form_has_it():
    speeds = np.linspace(3.9, 4.1, 21)
    expected = np.array([rimless_wheel(64, speed) for speed in speeds])
    found = rolled(64, speeds, 0.3)
    np.testing.assert_allclose(found, expected, rtol=5e-3)
    # Each impact that comes or goes within the half second is a step of the speed: only the mean is a slope.
    slope = (found[-1] - found[0]) / (speeds[-1] - speeds[0])
    assert slope == pytest.approx((expected[-1] - expected[0]) / (speeds[-1] - speeds[0]), rel=0.1)


@pytest.mark.parametrize("rate", [240, 960])
def test_what_is_round_loses_nothing(rate):
    # A ball that rolls and spins about any axis, and a cylinder that lies, keep their velocity.
    ball = Body("ball", [sphere(0.03)], 0.5, 0.4 * 0.5 * 0.03**2 * np.eye(3))
    across = 0.5 / 12 * (3 * 0.03**2 + 0.08**2)
    lying = Body("cylinder", [cylinder(0.03, 0.08)], 0.5, np.diag([across, across, 0.5 * 0.5 * 0.03**2]))
    half = math.sqrt(0.5)
    for body, q, w in ((ball, (1.0, 0.0, 0.0, 0.0), (3.0, 8.0, 5.0)), (lying, (half, half, 0.0, 0.0), (0.0, 8.0, 0.0))):
        model = Model(bodies=[body], time_step=1 / rate)
        V = torch.tensor([*w, w[1] * 0.03, -w[0] * 0.03, 0.0], dtype=torch.float64)
        state = State.at_rest(model, q_WB=q, p_WB=(0.0, 0.0, 0.03), V_WB=V)
        end = run(Stepper(model), nominal(model, friction_floor=0.5), state, 1.0).V_WB[-1, 0, 0]
        np.testing.assert_allclose(end.numpy(), V.numpy(), atol=1e-5)  # the contact's compliance


@pytest.mark.parametrize(("tilt", "seconds"), [(2.0, 0.12), (5.0, 0.15), (10.0, 0.2), (20.0, 0.3)])
def test_a_mug_that_is_let_go_on_its_rim_lies_still_about_as_soon_as_in_other_engines(tilt, seconds):
    # To 0.3 degrees: 0.02 to 0.16 s in Drake's contact of points and of surfaces, 0.09 to 0.29 s in MuJoCo.
    across = 0.0013
    mug = Body("mug", [cylinder(0.04, 0.08)], 1.0, np.diag([across, across, across]))
    model, a, worlds = Model(bodies=[mug], time_step=1 / RATE), math.radians(tilt), 8
    roll = torch.linspace(0.0, 0.7, worlds, dtype=torch.float64)
    c, s = math.cos(a / 2), math.sin(a / 2)
    q = torch.stack([c * roll.cos(), s * roll.cos(), -s * roll.sin(), c * roll.sin()], -1)[:, None]
    height = 0.04 * math.cos(a) + 0.04 * math.sin(a) + 1e-6
    V = torch.zeros(worlds, 1, 6, dtype=torch.float64)
    V[:, 0, 2] = torch.linspace(-0.3, 0.3, worlds, dtype=torch.float64)
    state = State.at_rest(model, worlds, q_WB=q, p_WB=(0.0, 0.0, height), V_WB=V)
    parameters = nominal(model, friction_floor=0.2, num_worlds=worlds)
    frames = run(Stepper(model), parameters, state, 0.5)
    up = 1.0 - 2.0 * (frames.q_WB[:, :, 0, 1] ** 2 + frames.q_WB[:, :, 0, 2] ** 2)
    assert float(up[round(seconds * RATE) :].min()) > math.cos(math.radians(0.3))
    rise = torch.stack([energy(model, parameters, frames.frame(i)) for i in range(frames.num_frames)]).diff(dim=0)
    assert float(rise.max()) < 1e-5


def test_a_rim_that_rolls_loses_the_work_of_rolling_friction_and_that_of_a_millimetre_at_most_on_its_corners():
    # The work is that of the weight at a lever of 0.2 mm, times the squared cosine of the tilt, over the turn.
    across, a, spin, seconds = 0.0013, math.radians(20.0), 4.0, 0.15
    model = Model(bodies=[Body("mug", [cylinder(0.04, 0.08)], 1.0, np.diag([across] * 3))], time_step=1 / RATE)
    lowest = np.array([0.0, 0.04 * (math.sin(a) - math.cos(a)), -0.04 * (math.sin(a) + math.cos(a))])
    w = np.array([0.0, spin, 0.0])
    q, p_WB = (math.cos(a / 2), math.sin(a / 2), 0.0, 0.0), (0.0, 0.0, -lowest[2] + 1e-6)
    state = State.at_rest(model, q_WB=q, p_WB=p_WB, V_WB=(*w, *-np.cross(w, lowest)))
    parameters = nominal(model, friction_floor=2.0)
    frames = run(Stepper(model), parameters, state, seconds)
    left = [float(energy(model, parameters, frames.frame(i))) for i in range(frames.num_frames)]
    cosine = 1.0 - 2.0 * (frames.q_WB[:, 0, 0, 1:3] ** 2).sum(-1).numpy()
    power = G * cosine**2 * frames.V_WB[:, 0, 0, :2].norm(dim=-1).numpy()
    way = np.cumsum(0.5 * (power[1:] + power[:-1]) / RATE)  # work over the lever
    for k in range(6, frames.num_frames):
        assert 2e-4 * way[k - 1] < left[0] - left[k] < (2e-4 + 1e-3) * way[k - 1]


@pytest.mark.parametrize("share", [0.3, 0.5, 0.9])
def test_a_block_that_rocks_keeps_what_its_corner_leaves_it(share):
    # Housner (1963): about an edge an inverted pendulum, and (1 - 3/2 sin^2 a) of the speed at the other one.
    a, b, mass = 0.02, 0.05, 0.5
    size = (2 * a, 2 * a, 2 * b)
    model = Model(bodies=[Body("block", [box(size)], mass, box_inertia(size, mass))], time_step=1 / RATE)
    arm, slender = math.hypot(a, b), math.atan2(a, b)
    tilt = share * slender
    start = (-arm * math.sin(slender - tilt), 0.0, arm * math.cos(slender - tilt))
    state = State.at_rest(model, q_WB=(math.cos(tilt / 2), 0.0, math.sin(tilt / 2), 0.0), p_WB=start)
    frames = run(Stepper(model), nominal(model, friction_floor=5.0), state, 0.3)
    about = float(model.bodies[0].inertia[1, 1]) + mass * arm**2
    angle, speed, step, found, hits = tilt, 0.0, 1e-5, [], []
    for k in range(round(0.3 / step)):
        if k % round(1 / RATE / step / 10) == 0:
            found.append((k * step, speed))
        speed -= step * mass * G * arm * math.sin(math.copysign(slender, angle) - angle) / about
        angle += step * speed
        if angle * (angle - step * speed) < 0.0:
            speed *= 1 - 1.5 * math.sin(slender) ** 2
            hits.append(k * step)
    times, speeds = np.array(found).T
    ours = frames.V_WB[:, 0, 0, 1].numpy()
    at = np.arange(len(ours)) / RATE
    # A frame beside an impact may be on its other side.
    beside = (np.abs(at[:, None] - hits) < 1.5 / RATE).any(-1)
    assert beside.sum() < 0.5 * len(at)
    assert np.abs(ours - np.interp(at, times, speeds))[~beside].max() < 0.02 * np.abs(speeds).max()


def test_a_corner_that_strikes_the_floor_leaves_as_its_closed_form():
    # A bar that falls on one end, frictionless: w = v / (c + I / (m c)), with c the way of that end from the middle.
    length, mass = 0.1, 0.2
    ends = [sphere(0.004, np.array([x, 0.0, 0.0])) for x in (-length / 2, length / 2)]
    inertia = mass * length**2 / 12
    bar = Body("bar", ends, mass, np.diag([1e-5, inertia, inertia]))
    model = Model(bodies=[bar], time_step=1 / RATE, gravity=(0.0, 0.0, 0.0))
    tilt, speed = 0.3, 0.8
    height = 0.0535 + 0.5 * length * math.sin(tilt)
    state = State.at_rest(
        model,
        q_WB=(math.cos(tilt / 2), 0.0, math.sin(tilt / 2), 0.0),
        p_WB=(0.0, 0.0, height),
        V_WB=(0.0, 0.0, 0.0, 0.0, 0.0, -speed),
    )
    frames = run(Stepper(model), nominal(model, friction_floor=0.0), state, 0.1)
    arm = 0.5 * length * math.cos(tilt)
    impulse = speed / (1 / mass + arm**2 / inertia)
    after = frames.V_WB[:, 0, 0][frames.V_WB[:, 0, 0, 1].abs() > 1e-6][0]
    assert float(after[5]) == pytest.approx(-speed + impulse / mass, rel=1e-4)
    assert abs(float(after[1])) == pytest.approx(impulse * arm / inertia, rel=1e-4)


def test_steps_with_more_impacts_than_are_told_apart_are_counted_and_lose_little_speed():
    # 64 sides at 12 rad/s meet the floor 122 times a second: 12 times in a step of 0.1 s, and once in one of 10 ms.
    found = {}
    for rate in (10, 100):
        model = wheel(64, rate)
        V = torch.tensor([0.0, 12.0, 0.0, 12.0 * RADIUS, 0.0, 0.0], dtype=torch.float64)
        state = State.at_rest(model, p_WB=(0.0, 0.0, RADIUS * math.cos(math.pi / 64)), V_WB=V)
        found[rate] = run(Stepper(model), nominal(model, friction_floor=3.0), state, SECONDS)
    assert int(found[10].early) == 5
    assert int(found[100].early) == 0
    ends = [float(frames.V_WB[-1, 0, 0, 1]) for frames in found.values()]
    np.testing.assert_allclose(ends, rimless_wheel(64, 12.0), rtol=0.03)


def test_a_long_step_in_which_a_block_falls_over_an_edge_is_taken_in_shorter_ones():
    # A block of 60 mm falls over its edge from 0.3 rad off the balance, with 8 rad/s, as a pendulum does.
    a, m = 0.06, 1.0
    about_edge, far = m * a * a * (1 / 6 + 1 / 2), a * math.sqrt(0.5)
    angle, speed, step = 0.3, 8.0, 1e-5
    for _ in range(round(0.04 / step)):
        middle = speed + 0.5 * step * m * G * far * math.sin(angle) / about_edge
        angle += step * middle
        speed = middle + 0.5 * step * m * G * far * math.sin(angle) / about_edge
    model = Model(bodies=[Body("block", [box((a, a, a))], m, box_inertia((a, a, a), m))], time_step=0.02)
    turn = 0.3 + math.pi / 4
    arm = far * torch.tensor([math.sin(0.3), 0.0, math.cos(0.3)], dtype=torch.float64)
    w = 8.0 * torch.tensor([0.0, 1.0, 0.0], dtype=torch.float64)
    V = torch.cat([w, torch.linalg.cross(w, arm)])
    q = (math.cos(turn / 2), 0.0, math.sin(turn / 2), 0.0)
    state = State.at_rest(model, q_WB=q, p_WB=tuple(arm.tolist()), V_WB=V)
    end = run(Stepper(model), nominal(model, friction_floor=5.0), state, 0.04)
    q_end = end.q_WB[-1, 0, 0].tolist()
    # Where no step is halved the angle is wrong by 3 mrad.
    assert 2 * math.atan2(q_end[2], q_end[0]) - math.pi / 4 == pytest.approx(angle, abs=5e-4)
    assert float(end.V_WB[-1, 0, 0, 1]) == pytest.approx(speed, abs=2e-3)
    there = far * torch.tensor([math.sin(angle), 0.0, math.cos(angle)], dtype=torch.float64)
    np.testing.assert_allclose(end.p_WB[-1, 0, 0].numpy(), there.numpy(), atol=2e-5)  # the edge has not moved


@pytest.mark.parametrize("friction", [0.2, 3.0])
def test_a_block_keeps_the_more_of_its_turn_the_further_in_its_face_lands(friction):
    # About one lower edge at +a the block turns with w, and lands at -b: the impulse (J_t, J_n) per mass there stops
    # the point, or it slides with J_t = mu J_n. With its moment of inertia k per mass and the height h of its middle:
    a, h, k, w = 0.02, 0.04, (0.04**2 + 0.08**2) / 12, 8.0

    def kept(b):
        across = (k + h * h - a * b) / (k + h * h + b * b)  # without sliding, by Housner's argument
        if h * (1.0 - across) <= friction * (a + b * across):
            return across
        lever = b - friction * h
        return (k - lever * a) / (k + lever * b)

    size = (2 * a, 0.12, 2 * h)
    inertia = np.diag([(0.12**2 + 4 * h * h) / 12, k, (0.12**2 + 4 * a * a) / 12])
    found = {}
    for name, number in (("corners", None), ("faces", FACES_POINTS), ("patch", PATCH_POINTS)):
        points = None if number is None else supporting_points(trimesh.creation.box(size), np.eye(3), number)
        model = Model(bodies=[Body("block", [box(size)], 1.0, inertia, points)], time_step=1 / 960)
        tilt = torch.linspace(0.03, 0.05, 4, dtype=torch.float64)
        q = torch.stack([(tilt / 2).cos(), 0 * tilt, (tilt / 2).sin(), 0 * tilt], -1)[:, None]
        x, z = h * tilt.sin() - a * tilt.cos(), a * tilt.sin() + h * tilt.cos()  # the edge at +a is at the origin
        V = torch.zeros(4, 1, 6, dtype=torch.float64)
        V[:, 0, 1], V[:, 0, 3], V[:, 0, 5] = -w, -w * z, w * x
        p = torch.stack([x, 0 * x, z], -1)[:, None]
        state = State.at_rest(model, 4, q_WB=q, p_WB=p, V_WB=V)
        frames = run(Stepper(model), nominal(model, friction_floor=friction, num_worlds=4), state, 0.02)
        turn, angle = -frames.V_WB[:, :, 0, 1], 2 * torch.atan2(frames.q_WB[:, :, 0, 2], frames.q_WB[:, :, 0, 0])
        ratios = []
        for world in range(4):
            landed = int((angle[:, world] < -1e-3).int().argmax())
            # Gravity slows the block about the edge on which it has landed.
            back = 9.81 * a / (k + a * a + h * h) / 960
            ratios.append((float(turn[landed + 2, world]) + 2 * back) / float(turn[: landed + 1, world].max()))
        found[name] = np.mean(ratios)
    middle = a / math.sqrt(3.0)  # of an even pressure's points
    assert found["corners"] == pytest.approx(kept(a), abs=0.04)
    for name in ("faces", "patch"):
        assert found[name] == pytest.approx(kept(middle), abs=0.1)
        assert found[name] > found["corners"] + 0.1
