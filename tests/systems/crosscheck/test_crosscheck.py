# SPDX-License-Identifier: MIT
import csv
import dataclasses
import functools
import math

import numpy as np
import pytest
import trimesh

from pinwm_drake.errors import ParameterError, SolverError
from pinwm_drake.geometry.meshes import load_mesh
from pinwm_drake.systems.crosscheck.crosscheck import crosscheck
from pinwm_drake.systems.crosscheck.difference import course_of, difference_of
from pinwm_drake.systems.crosscheck.motion import (
    SEPARATED,
    SLIDING,
    STICKING,
    Motion,
    SceneRig,
    contact_modes,
    run_trials,
    unlimited,
)
from pinwm_drake.systems.crosscheck.options import CrossCheckOptions
from pinwm_drake.systems.crosscheck.pushes import PushCheck, PushComparison, _judge
from pinwm_drake.systems.crosscheck.trials import draw_trials
from pinwm_drake.systems.engines.engine import FLOOR_PAIR, PUSHER_PAIR, ContactForces
from pinwm_drake.systems.engines.twin.physics import WorldPhysics
from pinwm_drake.systems.pusher.choice import COASTING, coasting_speed
from pinwm_drake.systems.scenario.schema import Pusher, Scenario, Shape, Start, Theta
from pinwm_drake.systems.scenario.setup import Setup, make_setup

G = 9.81
FRICTION = 0.1


def setup_of(name: str = "t_block", friction: float = FRICTION, **options) -> Setup:
    theta, start = Theta(1.0, friction, friction, 0.0), Start(yaw=[-math.pi, math.pi])
    return make_setup(Scenario(object=name, theta=theta, start=start, **options))


def motion_of(x, *, yaw=0.0, kinetic=None, rest=True, failure="", pusher=None) -> Motion:
    """An object that moves along x (n,) m, turned by `yaw` from the second time on; the pusher stops at once."""
    x = np.asarray(x, float)
    n = len(x)
    q = np.tile([math.cos(yaw / 2), 0, 0, math.sin(yaw / 2)], (n, 1))
    q[0] = [1, 0, 0, 0]
    return Motion(
        t=0.1 * np.arange(n),
        p_WO=np.stack([x, 0 * x, 0 * x], -1),
        q_WO=q,
        p_WP=np.zeros((n, 3)),
        kinetic=np.zeros(n) if kinetic is None else np.asarray(kinetic, float),
        height=np.zeros(n),
        floor=np.full(n, SLIDING),
        pusher=np.full(n, STICKING) if pusher is None else np.asarray(pusher),
        stop=0,
        rest=n - 1 if rest else None,
        failure=failure,
    )


def test_modes_go_by_the_speed_at_the_contacts():
    # The object turns about a contact of the floor that bears three quarters of the weight; the other one slides.
    forces = ContactForces(
        np.zeros(3, int),
        (FLOOR_PAIR, FLOOR_PAIR, PUSHER_PAIR),
        np.array([[1.0, 0, 0], [1.2, 0, 0], [1.0, 0.5, 0]]),
        np.array([[0, 0, 3.0], [0, 0, 1.0], [0, 1.0, 0]]),
    )
    still = np.array([1.0, 0, 0, 0, 1.0, 0, 0, 0, 0, 0, 0, 0, 0])
    assert contact_modes(forces, still, np.zeros(3)) == (STICKING, STICKING)
    # 0.2 m * 0.1 rad/s for a quarter of the weight: 5 mm/s on average, more than 2 mm/s.
    turning = np.array([1.0, 0, 0, 0, 1.0, 0, 0, 0, 0, 0.1, 0, 0, 0])
    assert contact_modes(forces, turning, np.array([-0.05, 0, 0])) == (SLIDING, STICKING)
    assert contact_modes(forces, turning, np.array([-0.04, 0, 0])) == (SLIDING, SLIDING)
    slow = 0.3 * turning[7:10]
    assert contact_modes(forces, np.array([*turning[:7], *slow, 0, 0, 0]), np.zeros(3)) == (STICKING, SLIDING)
    assert contact_modes(ContactForces.none(), turning, np.zeros(3)) == (SEPARATED, SEPARATED)
    other = dataclasses.replace(forces, worlds=np.ones(3, int))
    assert contact_modes(other, turning, np.zeros(3)) == (SEPARATED, SEPARATED)


def test_differences_are_those_after_rest_and_on_the_way():
    one = motion_of([0, 0.01, 0.02, 0.02, 0.02], yaw=0.3)
    other = motion_of([0, 0.015, 0.021], yaw=0.1, pusher=[STICKING, SLIDING, STICKING])
    apart = difference_of(one, other)
    assert apart.translation == pytest.approx(0.001)
    assert apart.path_translation == pytest.approx(0.005)
    assert apart.rotation == pytest.approx(0.2)
    assert apart.path_rotation == pytest.approx(0.2)
    # Over the four times before rest of the later one.
    assert apart.same_modes == pytest.approx(3 / 4)
    mirrored = dataclasses.replace(one, q_WO=-one.q_WO)
    assert difference_of(one, mirrored).path_rotation == 0.0


@pytest.mark.parametrize("bad", [{"rest": False}, {"failure": "SolverError: no solution"}])
def test_a_motion_without_an_end_agrees_with_nothing(bad):
    good, ill = motion_of([0, 0.01]), motion_of([0, 0.01], **bad)
    assert difference_of(good, ill).translation == math.inf
    assert difference_of(ill, good).rotation == math.inf
    course = course_of(ill, 9.81)
    assert not course.sound
    assert course_of(good, 9.81).sound
    assert course.words() == bad.get("failure", "does not come to rest")


def test_energy_from_nowhere_is_seen():
    falling = motion_of([0, 1, 2, 3], kinetic=[1.0, 0.5, 0.25, 0.0])
    assert not course_of(falling, 10.0).energy_rises
    again = dataclasses.replace(falling, kinetic=np.array([1.0, 0.4, 0.5, 0.0]))
    assert course_of(again, 10.0).energy_rise == pytest.approx(0.1)
    assert course_of(again, 10.0).energy_rises
    # What the weight of 10 N gives on a way of 10 mm is no such energy.
    lowered = dataclasses.replace(again, height=np.array([0.02, 0.02, 0.01, 0.01]))
    assert not course_of(lowered, 10.0).energy_rises


def test_a_verdict_takes_medians_and_counts_failures_as_infinite():
    options = CrossCheckOptions(engines=("point",), threshold_translation=0.003, threshold_rotation=math.degrees(0.1))
    still = motion_of([0, 0])

    def judge(*translations):
        results = []
        for way in translations:
            motion = motion_of([0, way]) if way is not None else motion_of([0, 0], rest=False)
            courses = {"twin": course_of(still, G), "point": course_of(motion, G)}
            results.append(PushComparison(None, {}, courses, {"point": difference_of(still, motion)}))
        return _judge("point", results, options)

    good = judge(0.001, 0.002, 0.9)
    assert (good.passed, good.unsound) == (True, 0)
    assert good.median_translation == pytest.approx(0.002)
    assert good.most_translation == pytest.approx(0.9)
    assert not judge(0.001, 0.004, 0.005).passed
    lost = judge(0.001, None, None)
    assert (lost.passed, lost.unsound, lost.median_translation) == (False, 2, math.inf)
    assert judge(None, None).median_translation == math.inf
    turned = PushComparison(None, {}, {name: course_of(still, G) for name in ("twin", "point")}, {})
    turned.differences["point"] = difference_of(still, motion_of([0, 0], yaw=0.11))
    assert not _judge("point", [turned], options).passed


def test_pushes_leave_the_object_sliding_and_start_clear_of_it():
    setup = unlimited(setup_of())
    trials = draw_trials(setup, setup, 4, 7)
    points = trimesh.sample.sample_surface(load_mesh(setup.twin.mesh_path), 20000, seed=0)[0]
    physics = WorldPhysics(setup.twin, np.array([1.0, 0, 0, 0]), 1)
    lowest = physics.scene.model.arrays.table.floor_points[:, 2].min()
    for trial in trials:
        push, p_WO = trial.push, trial.X_WO.translation()
        assert 0.85 < push.speed / coasting_speed(FRICTION, G) < 1.15
        # The twin's own points touch the floor.
        assert p_WO[2] + lowest == pytest.approx(0.0, abs=1e-9)
        assert push.p_WP[2] == pytest.approx(p_WO[2])
        surface = points @ trial.X_WO.rotation().matrix().T + p_WO
        assert np.linalg.norm(surface - push.p_WP, axis=1).min() > setup.twin.pusher.shape.radius + 1e-3
        touched = push.p_WP + 0.014 * push.direction_W
        assert np.linalg.norm(surface - touched, axis=1).min() < setup.twin.pusher.shape.radius
    assert coasting_speed(FRICTION, G) ** 2 / (2 * FRICTION * G) == pytest.approx(COASTING)
    yaws = {round(trial.X_WO.rotation().ToQuaternion().w(), 6) for trial in trials}
    assert len(yaws) == 4
    # A push does not depend on how many there are, and is set by the friction of the reference.
    again = draw_trials(setup.with_theta(friction_floor=0.07), setup, 2, 7)
    for one, other in zip(again, trials, strict=False):
        np.testing.assert_array_equal(one.push.to_vector(), other.push.to_vector())
        np.testing.assert_array_equal(one.X_WO.GetAsMatrix34(), other.X_WO.GetAsMatrix34())
    assert draw_trials(setup, setup, 1, 8)[0].push.speed != trials[0].push.speed


def test_limits_of_the_scenario_do_not_bind():
    pusher = Pusher(shape=Shape("sphere", 0.01), max_speed=0.01, low=[-0.01] * 3, high=[0.01] * 3)
    setup = unlimited(setup_of("cube", pusher=pusher, num_worlds=3))
    assert setup.scenario.num_worlds == 1
    trial = draw_trials(setup, setup, 1, 0)[0]
    motion = SceneRig(setup, "twin").run(trial)
    end = trial.push.p_WP + trial.push.distance * trial.push.direction_W
    np.testing.assert_allclose(motion.p_WP[-1], end, atol=1e-9)


@functools.cache
def check(factor: float) -> PushCheck:
    """Against point contact at the true friction, a twin with that friction times a factor."""
    setup, truth = setup_of(), {"friction_floor": FRICTION, "friction_pusher": FRICTION}
    options = CrossCheckOptions(engines=("point",), pushes=2)
    return crosscheck(setup.with_theta(friction_floor=factor * FRICTION), options, truth=truth)


def test_the_right_twin_passes():
    (verdict,) = check(1.0).verdicts
    assert verdict.passed
    # Measured: 0.4 mm and 0.4 degrees.
    assert verdict.median_translation < 1.5e-3
    assert verdict.median_rotation < math.radians(1.2)
    assert (verdict.unsound, verdict.rising) == (0, 0)


@pytest.mark.parametrize("factor", [pytest.param(0.7, marks=pytest.mark.nightly), 1.3])
def test_a_friction_that_is_wrong_by_30_per_cent_fails(factor):
    assert not check(factor).passed
    # Sliding on by 22 mm, less its 1.3th part: 5 mm; measured 8 mm and 4.5 mm.
    assert check(factor).verdicts[0].median_translation > 3.5e-3


def test_files_go_to_a_folder_that_is_a_text(tmp_path):
    found = check(1.0).write(str(tmp_path / "new" / "check"), setup_of(), "title")
    assert found == [tmp_path / "new/check/crosscheck.csv", tmp_path / "new/check/crosscheck.png"]
    rows = list(csv.DictReader(found[0].open()))
    assert [(row["push"], row["engine"]) for row in rows] == [
        (str(push), name) for push in range(len(check(1.0).pushes)) for name in ("twin", "point")
    ]
    ends = [one.differences["point"].translation for one in check(1.0).pushes]
    assert [float(row["translation"]) for row in rows[1::2]] == pytest.approx(ends, rel=1e-5)
    assert found[1].read_bytes().startswith(b"\x89PNG")


@pytest.mark.nightly
def test_hydroelastic_contact_agrees_and_processes_make_no_difference():
    setup = unlimited(setup_of("cube", 0.3))
    cases, trials = {"twin": setup, "hydroelastic": setup}, draw_trials(setup, setup, 2, 3)
    done = []
    alone = run_trials(cases, trials, report=lambda: done.append(1))
    shared = run_trials({"twin": setup}, trials, processes=2)
    assert len(done) == 2
    for one, other in zip(alone, shared, strict=True):
        # To rounding: kernels that were compiled here may add in another order than those that were loaded.
        np.testing.assert_allclose(one["twin"].p_WO, other["twin"].p_WO, rtol=0.0, atol=1e-12)
        np.testing.assert_allclose(one["twin"].kinetic, other["twin"].kinetic, rtol=1e-9, atol=1e-15)
        # The pusher of the plant is where that of the twin is.
        n = min(len(one[name].t) for name in cases)
        np.testing.assert_allclose(one["twin"].p_WP[:n], one["hydroelastic"].p_WP[:n], atol=2e-5)
        apart = difference_of(one["twin"], one["hydroelastic"])
        # Measured: 1.8 mm and 3.3 degrees of 18 and 59.
        assert apart.translation < 4e-3
        assert apart.rotation < math.radians(6)
        assert apart.same_modes > 0.7


def test_an_engine_that_gives_up_says_so(monkeypatch):
    setup = unlimited(setup_of("cube", 0.3))
    trial, rig = draw_trials(setup, setup, 1, 0)[0], SceneRig(setup, "twin")
    advance, calls = WorldPhysics.advance, []

    def sometimes(self, *arguments):
        calls.append(1)
        if len(calls) > 20:
            raise SolverError("world 0: no solution", worlds=(0,))
        return advance(self, *arguments)

    monkeypatch.setattr(WorldPhysics, "advance", sometimes)
    motion = rig.run(trial)
    assert "world 0: no solution" in motion.failure
    assert motion.rest is None
    assert len(motion.t) == 21


@pytest.mark.parametrize(
    ("option", "value", "message"),
    [
        ("engines", ("twin",), "engine: got 'twin'; allowed: hydroelastic, point"),
        ("engines", (), "engines: got none"),
        ("engines", ("point", "point"), "each once"),
        ("pushes", 0, "pushes: got 0"),
        ("seed", -1, "seed: got -1"),
        ("processes", 0, "processes: got 0"),
        ("threshold_translation", 0.0, "--threshold-translation: got 0.0"),
        ("threshold_rotation", math.nan, "--threshold-rotation: got nan"),
    ],
)
def test_options_out_of_range_are_refused(option, value, message):
    with pytest.raises(ParameterError, match=message):
        CrossCheckOptions(**{option: value})
