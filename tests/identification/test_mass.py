# SPDX-License-Identifier: MIT
from dataclasses import replace

import numpy as np
import pytest
import torch

from pinwm_drake.capture.episodes import PusherTrajectory
from pinwm_drake.identification.mass import MassScale, fit_mass_scale, with_mass
from pinwm_drake.spatial.poses import Pose
from pinwm_drake.twin.twin import Draws
from tests.capture.cube import SIDE
from tests.report.samples import log
from tests.twin.samples import cube_twin, estimates, pusher_force, weighing

LEVEL = torch.tensor([1.0, 0.0, 0.0, 0.0], dtype=torch.float64)
STEP, GAP_TIME, END = 1 / 240, 0.25, 1.5


def course(seed=0, worlds=20, end=END, spread=0.0):
    """Simulated impulses of a push for 1 kg: an impact, then a force that changes; and a log without forces."""
    edges = np.arange(round(end / STEP) + 1) * STEP
    middle = edges[:-1] + 0.5 * STEP
    force = np.zeros((len(middle), 3))
    touching = middle > GAP_TIME
    force[touching, 0] = -1.0 - 0.3 * np.sin(4.0 * middle[touching])
    force[touching, 1] = 0.2 * np.cos(5.0 * middle[touching])
    force[np.argmax(touching), 0] -= 0.1 / STEP
    factors = np.exp(spread * np.random.default_rng(seed).normal(size=worlds))
    factors[0] = 1.0
    impulses = force[:, None] * factors[:, None] * STEP
    still = np.zeros((len(edges), 3))
    trajectory = PusherTrajectory(edges, still, np.tile([1.0, 0.0, 0.0, 0.0], (len(edges), 1)), still, None)
    return trajectory, np.tile(edges[:, None], (1, worlds)), impulses


def measured(push, mass, *, offset=(0.0, 0.0, 0.0), noise=0.0, late=0.0, seed=1):
    """The push with forces for a mass, in each row the mean since the one before; the impact comes late by so much."""
    trajectory, edges, impulses = push
    force = np.concatenate([np.zeros((1, 3)), impulses[:, 0] / STEP]) * mass
    force = np.roll(force, round(late / STEP), axis=0)
    force = force + np.array(offset) + noise * np.random.default_rng(seed).normal(size=force.shape)
    return replace(trajectory, force_W=force), edges, impulses


def test_the_mass_is_found_though_the_sensor_has_an_offset_and_impacts_are_late():
    found = fit_mass_scale([measured(course(), 2.5, offset=(3.0, -1.0, 0.5), noise=0.2, late=0.008)], 0)
    assert found.value == pytest.approx(2.5, rel=0.01)
    assert found.window == 0.1
    assert found.alike > 0.99
    assert np.quantile(found.draws, 0.025) < 2.5 < np.quantile(found.draws, 0.975)
    assert found.draws.std() < 0.05


def test_a_window_with_a_knock_hardly_counts():
    log_of, *simulated = measured(course(), 0.7)
    knocked = log_of.force_W.copy()
    knocked[(log_of.t > 0.82) & (log_of.t < 0.87), 0] += 3.0  # N; the object's own force is 0.7
    found = fit_mass_scale([(replace(log_of, force_W=knocked), *simulated)], 0)
    assert found.value == pytest.approx(0.7, rel=0.02)


def test_the_interval_holds_what_the_draws_differ_by():
    found = fit_mass_scale([measured(course(worlds=400, spread=0.1), 2.0)], 0)
    # The mass of a draw with a larger force is smaller.
    assert np.log(found.draws).std() == pytest.approx(0.1, rel=0.15)
    assert found.value == pytest.approx(2.0, rel=0.01)


def test_pushes_are_put_together_and_few_windows_are_made_shorter():
    short = [measured(course(end=0.5), 1.5), measured(course(end=0.45), 1.5)]
    found = fit_mass_scale(short, 0)
    assert (found.value, found.window) == (pytest.approx(1.5, rel=0.02), 0.05)


@pytest.mark.parametrize(
    ("push", "words"),
    [
        (measured(course(end=0.30), 1.0), "touch for fewer than 3 windows of 0.025 s"),
        (measured(course(), 0.0, noise=0.3), "does not follow the twin's"),
        (measured(course(), -1.0), "points against the twin's"),
    ],
)
def test_forces_that_do_not_tell_are_refused(push, words):
    assert words in fit_mass_scale([push], 0)


def test_rows_that_are_too_few_are_refused():
    trajectory, edges, impulses = measured(course(), 1.0)
    some = {name: getattr(trajectory, name)[::24] for name in ("t", "p_WP", "q_WP", "v_WP", "force_W")}
    assert "a row every 0.1 s is too few" in fit_mass_scale([(replace(trajectory, **some), edges, impulses)], 0)


@pytest.mark.nightly
def test_the_mass_of_a_twin_is_that_of_its_own_forces(tmp_path):
    values = {"restitution_floor": 0.0, "restitution_pusher": 0.0}
    light = cube_twin(tmp_path, theta=estimates(**values))
    heavy = weighing(light, 3.7)
    start = Pose(LEVEL, torch.tensor([0.0, 0.0, SIDE / 2], dtype=torch.float64))
    ends = np.array([0.0, 1.0])
    edges, felt_W = pusher_force(heavy, start, log(11), ends)
    _, nominal_W = pusher_force(light, start, log(11), ends)
    plain = log(11)
    rows = {
        "p_WP": np.stack([np.interp(edges, plain.t, plain.p_WP[:, axis]) for axis in range(3)], -1),
        "q_WP": np.tile(plain.q_WP[:1], (len(edges), 1)),
        "v_WP": np.tile(plain.v_WP[:1], (len(edges), 1)),
    }
    known = PusherTrajectory(edges, **rows, force_W=np.concatenate([np.zeros((1, 3)), felt_W]))
    worlds = np.tile(edges[:, None], (1, 5)), np.tile(nominal_W[:, None] / 240, (1, 5, 1))
    assert fit_mass_scale([(known, *worlds)], 0).value == pytest.approx(3.7, rel=0.01)


def test_mass_and_moments_of_a_twin_grow_together(tmp_path):
    names = ["mass", "inertia_zz", "friction_floor"]
    twin = cube_twin(tmp_path, draws=Draws(names, np.array([[1.0, 2.0, 0.3], [1.0, 3.0, 0.4]])))
    scale = MassScale(2.0, np.array([1.9, 2.2]), 12, 0.1, 0.99)
    found = with_mass(twin, scale)
    for name in ("mass", "inertia_xx", "inertia_yy", "inertia_zz"):
        assert found.theta[name].value == pytest.approx(2.0 * twin.theta[name].value)
    low, high = twin.theta["inertia_zz"].interval
    assert found.theta["inertia_zz"].interval == pytest.approx((2.0 * low, 2.0 * high))
    assert found.theta["friction_floor"] == twin.theta["friction_floor"]
    mass = found.theta["mass"]
    assert mass.identifiable
    assert mass.interval[0] < mass.value < mass.interval[1]
    np.testing.assert_allclose(found.draws.values, [[1.9, 3.8, 0.3], [2.2, 6.6, 0.4]])
    assert found.provenance["force"]["windows"] == 12


def test_a_twin_says_why_forces_were_ignored(tmp_path):
    twin = cube_twin(tmp_path)
    found = with_mass(twin, "it never changes")
    assert found.theta["mass"].value == twin.theta["mass"].value
    assert found.theta["mass"].note.endswith("the force on the pusher is ignored: it never changes")
    assert found.provenance["force"] == {"note": "the force on the pusher is ignored: it never changes"}
    assert with_mass(twin, None) is twin
