# SPDX-License-Identifier: MIT
import dataclasses

import numpy as np
import pytest

from pinwm_drake.cousins.domain import CousinDomains
from pinwm_drake.errors import InputError, ParameterError
from pinwm_drake.experiments.evaluation.run import evaluate
from pinwm_drake.experiments.golden_samples import export_bundle
from pinwm_drake.experiments.requests.evaluate import EvaluateRequest
from pinwm_drake.experiments.requests.train import TrainRequest
from pinwm_drake.experiments.training import doubts, method_of, train, worlds_of
from pinwm_drake.learning.policy import read_policy
from pinwm_drake.systems.envs.policy_scene import spec_environment
from pinwm_drake.systems.mpc.waypoints import WaypointOptions
from pinwm_drake.systems.scenario.load import load_setup
from pinwm_drake.tasks.waypoints import WAYPOINTS_FILE
from pinwm_drake.twin.twin import Estimate
from pinwm_drake.twin.write import write_twin

pytestmark = pytest.mark.usefixtures("read_operators_once")


@pytest.mark.parametrize(
    ("algorithm", "worlds", "steps"),
    [("sac", 4, [0, 80, 160, 240, 320, 400, 480, 512]), ("ppo", 2, [0, 128, 256, 384, 512, 512])],
)
def test_a_training_is_a_call_that_prints_nothing(tmp_path, capsys, algorithm, worlds, steps):
    told = []
    request = TrainRequest(
        "push_t",
        tmp_path,
        method="state",
        algorithm=algorithm,
        worlds=worlds,
        image_size=32,
        steps=512,
        round_steps=512,
        episodes=4,
    )
    policy = train(request, report=told.append)
    assert capsys.readouterr() == ("", "")
    kept = read_policy(tmp_path)
    assert kept.spec == policy.spec
    assert kept.provenance["algorithm"] == algorithm
    assert kept.provenance["trained_in"] == policy.provenance["trained_in"]
    for name, values in policy.actor.state_dict().items():
        np.testing.assert_array_equal(kept.actor.state_dict()[name], values)
    # Of the beginning, of rollouts, and of the round.
    assert [step.steps for step in told] == steps
    assert {step.stage for step in told} == {"teacher"}


def test_an_interruption_passes_through_and_a_second_training_is_refused(tmp_path):
    def interrupt(step):
        if step.done == 0.5 and not np.isnan(step.success):
            raise KeyboardInterrupt

    options = {"method": "state", "worlds": 4, "image_size": 32, "steps": 512, "round_steps": 256, "episodes": 4}
    with pytest.raises(KeyboardInterrupt):
        train(TrainRequest("push_t", tmp_path, **options), report=interrupt)
    with pytest.raises(InputError, match="--resume"):
        train(TrainRequest("push_t", tmp_path, **options))


@pytest.mark.parametrize(
    "values",
    [
        {"method": "dreams"},
        {"algorithm": "reinforce"},
        {"worlds": 0},
        {"seed": -1},
        {"yaw": 4.0},
        {"teacher": "x", "method": "ppo"},
        {"auxiliary": False},
        {"latency": (-0.1, 0.0)},
        {"latency": (0.1, 0.0)},
        {"acceleration": 0.0},
        {"acceleration": 7.0, "lag": (0.0, 0.1)},
        {"device": "tpu"},
        {"mask_error": -0.5},
        {"mask_error": 1.5},
        {"mask_error": 0.5, "method": "ppo"},
    ],
)
def test_options_that_make_no_sense_are_refused(tmp_path, values):
    with pytest.raises(ParameterError, match=next(iter(values)).replace("_", "-")):
        TrainRequest(scene="push_t", out=tmp_path, **values)


@pytest.mark.nightly
def test_a_twin_learns_to_flip_in_the_scene_of_that_task(tmp_path):
    brief = WaypointOptions(strokes=64, sieves=((1, 4),), attempts=1, rounds=0)
    twin = load_setup("flip_mug").with_theta(friction_floor=0.22).twin
    write_twin(tmp_path / "twin", twin)
    cases = ({"task": "flip"}, {"in_scene": "flip_mug", "history": 0, "latency": (0.0, 0.0)})
    for k, options in enumerate(cases):
        request = TrainRequest(
            str(tmp_path / "twin"), tmp_path / str(k), method="state", worlds=2, steps=128, round_steps=128, episodes=1,
            **options,
        )  # fmt: skip
        policy = train(request, search=brief)
        assert (tmp_path / str(k) / "waypoints" / WAYPOINTS_FILE).exists()
        assert policy.provenance["task"] == "flip"
        assert policy.spec.scene.object.name == "mug"
        assert policy.spec.history == options.get("history", 2)
        assert policy.spec.latency == options.get("latency", (0.0, 0.12))
        assert policy.provenance["trained_in"]["scene"] == "flip_mug"
        assert policy.provenance["trained_in"]["task"]["up"] == [0.0, 0.0, -1.0]


def test_what_is_late_and_seen_of_a_flip_is_the_tasks_where_nothing_is_said(tmp_path):
    flip = worlds_of(TrainRequest("flip_mug", tmp_path, worlds=2)).options
    assert (flip.image_size, flip.frames, flip.history) == (256, 3, 2)
    assert (flip.latency, flip.lag) == ((0.0, 0.12), (0.0, 0.0))
    given = TrainRequest("flip_mug", tmp_path, worlds=2, image_size=32, history=0, latency=(0.0, 0.0), lag=(0.0, 0.01))
    flip = worlds_of(given).options
    assert (flip.image_size, flip.history, flip.latency, flip.lag) == (32, 0, (0.0, 0.0), (0.0, 0.01))
    stacked = worlds_of(TrainRequest("flip_mug", tmp_path, worlds=2, method="ppo")).options
    assert (stacked.image_size, stacked.history) == (64, 0)
    push = worlds_of(TrainRequest("push_t", tmp_path, worlds=2)).options
    assert (push.image_size, push.history, push.latency, push.lag) == (64, 0, (0.0, 0.0), (0.0, 0.0))


def test_the_pusher_of_a_training_accelerates_no_faster_than_is_asked_for(tmp_path):
    worlds = worlds_of(TrainRequest("push_t", tmp_path, worlds=2, acceleration=0.5))
    assert worlds.about["acceleration"] == 0.5
    env = worlds.task_worlds("state")
    env.reset()
    before = env.worlds.run.p_WP.copy()
    env.step(np.tile([-1.0, 0.0], (2, 1)))
    # From rest, with 0.5 m/s^2 for 0.1 s; the scene's speed is more than the 0.05 m/s at the end.
    np.testing.assert_allclose((env.worlds.run.p_WP - before)[:, 0], -0.5 * 0.5 * 0.1**2, rtol=1e-6)
    assert "acceleration" not in worlds_of(TrainRequest("push_t", tmp_path, worlds=2)).about


def test_frictions_with_which_a_flip_is_not_known_to_be_possible_are_told(tmp_path):
    assert doubts(TrainRequest("flip_mug", tmp_path)) == []
    assert doubts(TrainRequest("push_t", tmp_path, friction_floor=(0.01, 0.9))) == []
    assert doubts(TrainRequest("flip_mug", tmp_path, friction_floor=(0.05, 0.3))) == [
        "friction_floor is 0.05 to 0.3; flip_mug is known to be possible from 0.1 to 0.5"
    ]
    write_twin(tmp_path / "twin", load_setup("flip_mug").with_theta(friction_pusher=1.4).twin)
    (pusher,) = doubts(TrainRequest(str(tmp_path / "twin"), tmp_path, task="flip"))
    assert pusher.startswith("friction_pusher is 1.4;")


def test_a_camera_as_filmed_shows_the_object_where_the_twin_says_that_it_does(tmp_path):
    twin = load_setup("flip_mug").twin
    view = {"view_x": 0.012, "view_y": -0.009, "view_z": 0.018}
    told = dataclasses.replace(twin, nuisance={name: Estimate(value, None, True, "m") for name, value in view.items()})
    for name, one in (("plain", twin), ("told", told)):
        write_twin(tmp_path / name, one)
    requests = [
        TrainRequest(str(tmp_path / name), tmp_path / "out", in_scene="flip_mug", worlds=2, as_filmed=flag)
        for name, flag in (("told", False), ("told", True), ("plain", True))
    ]
    places, states = [], []
    for request in requests[:2]:
        worlds = worlds_of(request, CousinDomains(0.0, False, 0))
        env = worlds.task_worlds("rgb_state")
        env.seed(0)
        seen = env.reset()
        shown = (seen["image"][..., -3:] != 255).any(-1)
        places.append([np.argwhere(one).mean(0) for one in shown])
        assert worlds.about["view"] == (list(view.values()) if request.as_filmed else [0.0, 0.0, 0.0])
        states.append(seen["state"])
    np.testing.assert_array_equal(*states)  # it is what is seen of the object that is elsewhere
    X_CW, (fx, fy, *_) = worlds.setup.X_WC.inverse(), worlds.setup.camera.intrinsics.tolist()
    p_WO = env.worlds.run.object_state[:, 4:7]
    for world in range(2):
        pixels = []
        for p in (p_WO[world], p_WO[world] + list(view.values())):
            x, y, z = X_CW.multiply(p)
            pixels.append(np.array([fy * y / z, fx * x / z]))  # rows, columns
        found, expected = places[1][world] - places[0][world], pixels[1] - pixels[0]
        # What is seen of a mug is up to 5 % nearer to the camera than its origin.
        assert np.linalg.norm(found - expected) < 0.1 * np.linalg.norm(expected)
        assert np.linalg.norm(expected) > 3.0
    with pytest.raises(ParameterError, match=r"--as-filmed.*view_x"):
        worlds_of(requests[2])


def test_an_unknown_task_is_refused(tmp_path):
    with pytest.raises(ParameterError, match=r"task: got 'juggle'; allowed: .*push"):
        train(TrainRequest("push_t", tmp_path, task="juggle"))


@pytest.fixture(scope="module")
def sees_the_past(tmp_path_factory):
    """Folder of a brief training whose policies see two past states and actions."""
    folder = tmp_path_factory.mktemp("history")
    short = {"worlds": 4, "image_size": 32, "steps": 128, "round_steps": 128, "rounds": 1, "images": 64, "updates": 4}
    train(TrainRequest("push_t", folder, history=2, frames=2, episodes=4, threads=1, **short))
    return folder


def test_teacher_and_student_that_see_the_past_are_trained_read_and_evaluated(sees_the_past, tmp_path):
    teacher, student = read_policy(sees_the_past / "teacher" / "policy"), read_policy(sees_the_past)
    assert (teacher.spec.history, student.spec.history, student.spec.frames) == (2, 2, 3)
    for name, values in teacher.actor.state_dict().items():
        np.testing.assert_array_equal(student.actor.actor.state_dict()[name], values)
    for folder in (sees_the_past / "teacher" / "policy", sees_the_past):
        request = EvaluateRequest(str(folder), scene="push_t", engine="point", episodes=1, max_steps=3)
        found = evaluate(request, tmp_path / folder.name, workers=1)
        assert found.episodes == 1
    env = spec_environment(student.spec, "push_t", "twin")
    seen, _ = env.reset(seed=0)
    action = student.predict(seen)[0]
    assert action.shape == (2,)
    past = seen | {"pusher": seen["pusher"] + np.array([0.0, 0.0, *[0.3] * 8], np.float32)}
    assert not np.allclose(student.predict(past)[0], action, atol=1e-6)


def test_a_policy_that_sees_the_past_has_a_bundle_and_teaches_none_that_does_not(sees_the_past, tmp_path):
    bundle = export_bundle(sees_the_past, tmp_path / "bundle", arms=False)
    assert bundle.contract["inputs"][1]["shape"] == [10]
    request = TrainRequest("push_t", tmp_path / "run", teacher=sees_the_past / "teacher" / "policy", worlds=2)
    with pytest.raises(InputError, match="a history of 2; allowed: 0"):
        train(request)


@pytest.mark.parametrize(("minutes", "rounds", "images"), [(None, 5, 24_576), (30.0, 10, 8192)])
def test_a_budget_of_minutes_has_smaller_rounds_so_that_a_student_sees_where_it_goes_itself(
    tmp_path, minutes, rounds, images
):
    request = TrainRequest("flip_mug", tmp_path, minutes=minutes)
    options = method_of(request, worlds_of(request).setup.task).options
    assert (options.rounds, options.round_images) == (rounds, images)
    given = dataclasses.replace(request, images=100, rounds=2)
    options = method_of(given, worlds_of(given).setup.task).options
    assert (options.rounds, options.round_images) == (2, 100)
