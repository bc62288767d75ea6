# SPDX-License-Identifier: MIT
import numpy as np
import pytest

from pinwm_drake.cousins.cousin import CousinDraw
from pinwm_drake.cousins.domain import CousinDomains
from pinwm_drake.errors import ParameterError
from pinwm_drake.learning.world_evaluation import evaluate_worlds, usual_starts
from pinwm_drake.systems.envs.training_worlds import DomainPool, TrainingWorlds, training_options
from pinwm_drake.systems.envs.worlds import Worlds
from pinwm_drake.systems.scenario.start import StartDistribution
from pinwm_drake.tasks.waypoints import Waypoints


def training_worlds(**changes):
    options = training_options(image_size=32, frames=2, **changes)
    return TrainingWorlds("push_t", options, num_worlds=3, domains=CousinDomains(seed=4))


@pytest.fixture(scope="module")
def worlds():
    return training_worlds()


def thetas(pool, n=12):
    return [pool(0).theta["friction_floor"] for _ in range(n)]


def test_a_pool_follows_from_its_seed_and_gives_several_cousins(worlds):
    draw = CousinDraw(worlds.setup.twin, seed=1)
    pool = DomainPool(draw.cousin, 8)
    pool.begin(5)
    first = thetas(pool)
    pool.begin(6)
    other = thetas(pool)
    pool.begin(5)
    assert thetas(pool) == first
    assert not set(first) & set(other)
    assert 1 < len(set(first)) <= 8
    truth = worlds.setup.twin.theta["friction_floor"].value
    assert all(0.9 * truth <= value <= 1.1 * truth for value in first)


def test_a_pool_of_none_is_refused(worlds):
    with pytest.raises(ParameterError, match="size"):
        DomainPool(CousinDraw(worlds.setup.twin).cousin, 0)


def test_worlds_of_a_round_follow_from_its_seed(worlds):
    env = worlds.worlds("rgb_state")
    actions = np.random.default_rng(0).uniform(-1, 1, (12, 3, 2)).astype(np.float32)

    def play(seed):
        worlds.begin(seed)
        env.seed(seed)
        seen = [env.reset()]
        seen += [env.step(action)[0] for action in actions]
        return {name: np.stack([one[name] for one in seen]) for name in seen[0]}

    first, other, again = play(1), play(2), play(1)
    for name in first:
        assert np.array_equal(first[name], again[name])
    assert not np.array_equal(first["state"], other["state"])
    assert not np.array_equal(first["image"], other["image"])


@pytest.mark.parametrize(("kind", "history"), [("state", 0), ("rgb_state", 0), ("state", 2), ("rgb_state", 2)])
def test_worlds_go_on_bit_by_bit_from_a_state_that_they_gave(worlds, kind, history):
    actions = np.random.default_rng(0).uniform(-1, 1, (14, 3, 2)).astype(np.float32)
    other = training_worlds(max_steps=4, history=history)

    def play(env, some):
        out = [env.step(action) for action in some]
        seen = [[one[0]] if kind == "state" else list(one[0].values()) for one in out]
        rows = np.stack([np.concatenate([part.ravel() for part in parts]) for parts in seen])
        infos = [[{k: v for k, v in info.items() if not k.startswith("terminal")} for info in one[3]] for one in out]
        return rows, np.stack([one[1] for one in out]), np.stack([one[2] for one in out]), infos

    env = other.worlds(kind)
    other.begin(3)
    env.seed(3)
    env.reset()
    play(env, actions[:6])
    state = env.get_state()
    whole = play(env, actions[6:])
    again = other.worlds(kind)
    other.begin(3)
    again.seed(9)
    again.set_state(state)
    rest = play(again, actions[6:])
    assert whole[2].any()
    for a, b in zip(whole[:3], rest[:3], strict=True):
        assert np.array_equal(a, b)
    assert whole[3] == rest[3]


def test_worlds_of_state_and_of_images_are_alike(worlds):
    state, images = worlds.worlds("state"), worlds.worlds("rgb_state")
    for env in (state, images):
        env.seed(7)
    assert np.allclose(state.reset(), images.reset()["state"])
    assert worlds.spec("state").image_shape == (32, 32, 6)
    assert worlds.spec("rgb").max_translation == 0.02


def test_without_delta_all_worlds_are_the_twin():
    worlds = TrainingWorlds("push_t", num_worlds=2, domains=CousinDomains(0.0))
    assert worlds.pool is None
    worlds.begin(1)
    assert worlds.about["delta"] == 0.0


def test_the_range_of_the_start_can_be_widened():
    worlds = TrainingWorlds("push_t", num_worlds=64, yaw=np.pi)
    env = worlds.worlds("state")
    env.seed(0)
    angle = np.arctan2(*env.reset()[:, [3, 2]].T)
    assert np.abs(angle).max() > 0.8 * np.pi
    assert worlds.about["start_yaw"] == [-np.pi, np.pi]


def test_what_success_is_can_be_narrowed():
    worlds = TrainingWorlds("push_t", training_options(task={"tolerance": 0.01, "turn_tolerance": 0.1}), num_worlds=2)
    env = worlds.worlds("state")
    nearer = (0.9 * 0.01, 0.9 * 0.1)
    assert (env.worlds.task.tolerance, env.worlds.task.turn_tolerance) == pytest.approx(nearer)
    spec = worlds.spec("rgb")
    assert (spec.task.tolerance, spec.task.turn_tolerance) == (0.01, 0.1)
    assert (env.worlds.task.reward, spec.task.reward) == ("shaped", "paper")


class Still:
    """Policy that moves nothing and keeps the first states that it saw."""

    def __init__(self):
        self.seen = None

    def predict(self, observation, state=None, episode_start=None, deterministic=True):
        self.seen = observation.copy() if self.seen is None else self.seen
        return np.zeros((len(observation), 3), np.float32), None


def test_episodes_of_a_training_begin_at_waypoints_too_and_those_of_its_evaluations_where_the_scene_says():
    worlds = TrainingWorlds("flip_cube", training_options(image_size=16), num_worlds=16, domains=CousinDomains(0.0))
    before = worlds.about
    tipped = np.zeros((1, 13))
    tipped[0, :7] = np.cos(0.3), np.sin(0.3), 0.0, 0.0, 0.1, 0.0, 0.05
    worlds.waypoints = Waypoints(tipped, np.array([[0.0, 0.2, 0.05]]))
    assert worlds.about["waypoints"] != before["waypoints"]
    env, policy = worlds.worlds("state"), Still()
    env.seed(1)
    begun = env.reset()
    there = np.isclose(begun[:, 0], 1.0, atol=1e-6) & np.isclose(begun[:, 16], 2.0, atol=1e-6)
    assert 4 < there.sum() < 16
    evaluate_worlds(env, policy, 16, seed=1)
    assert np.abs(policy.seen[:, 5]).max() < 1e-6
    env.seed(1)
    assert np.array_equal(env.reset(), begun)
    env.set_options({"p_WP": np.array([0.2, 0.0, 0.1])})  # what is asked for is given
    env.reset()
    np.testing.assert_allclose(env.worlds.run.p_WP, [[0.2, 0.0, 0.1]] * 16, atol=1e-6)


def test_episodes_of_a_training_go_on_where_the_one_before_met_its_time_limit_and_begin_anew_out_of_reach():
    options = training_options(image_size=16, max_steps=1)
    worlds = TrainingWorlds("flip_cube", options, num_worlds=64, domains=CousinDomains(0.0))
    env, policy = worlds.task_worlds("state"), Still()
    env.seed(1)
    env.reset()
    state = np.zeros((64, 13))
    state[:, 0], state[:, 4], state[:, 6] = 1.0, 0.1, env.worlds.task.height
    state[32:, 4] = 0.5  # beyond the pusher's range

    def go_on():
        env.worlds.set_object_states(state, np.tile([-0.2, 0.2, 0.1], (64, 1)))
        return env.step(np.zeros((64, 3)))

    _, _, done, infos = go_on()
    assert done.all()
    assert all(info["TimeLimit.truncated"] for info in infos)
    there = np.isclose(env.worlds.run.p_WP, [-0.2, 0.2, 0.1], atol=1e-6).all(1)
    assert not there[32:].any()
    assert 1 < there[:32].sum() < 17  # a quarter of them
    assert np.allclose(env.worlds.run.object_state[:32][there[:32], 4:7], state[0, 4:7], atol=1e-3)
    assert worlds.about["continued"] == 0.25
    evaluate_worlds(env, policy, 128, seed=1)
    assert env.worlds.continued == 0.25
    with usual_starts(env):
        go_on()
    assert not np.isclose(env.worlds.run.p_WP, [-0.2, 0.2, 0.1], atol=1e-6).all(1).any()
    env.worlds.set_object_states(state, np.tile([-0.2, 0.2, 0.1], (64, 1)))
    env.worlds.advance(np.zeros((64, 3)))
    env.reset()  # a new run of the worlds begins where the scene says
    assert not np.isclose(env.worlds.run.p_WP, [-0.2, 0.2, 0.1], atol=1e-6).all(1).any()
    assert "continued" not in TrainingWorlds("push_t", num_worlds=1).about


def test_some_episodes_of_a_training_begin_as_after_a_try_that_failed():
    worlds = TrainingWorlds("flip_mug", training_options(image_size=16), num_worlds=200, domains=CousinDomains(0.0))
    env, policy = worlds.task_worlds("state"), Still()

    def behind():
        """Flags: the pusher is where no episode of the scene begins, away from the base or above the height there."""
        off = env.worlds.run.p_WP - env.worlds.run.object_state[:, 4:7]
        return (off[:, 0] > 0.0) | (env.worlds.run.p_WP[:, 2] > 0.07)

    env.seed(1)
    env.reset()
    assert 25 < behind().sum() < 65  # 0.25 of 200, and nearly all of these
    assert np.linalg.norm(env.worlds.run.object_state[:, 7:], axis=1).max() == 0.0
    with usual_starts(env):
        env.reset()
        assert not behind().any()
    evaluate_worlds(env, policy, 200, seed=1)
    assert (policy.seen[:, 17] < 0.5).all()
    assert env.worlds.retries == worlds.about["retries"] == 0.25
    assert TrainingWorlds("push_t", num_worlds=1).task_worlds("state").worlds.retries == 0.0


def test_velocities_in_a_training_of_flips_are_disturbed_in_shares_of_themselves():
    worlds = TrainingWorlds("flip_cube", training_options(image_size=16), num_worlds=256, domains=CousinDomains(0.0))
    env = worlds.worlds("state").worlds
    env.reset([*range(256)])
    sliding = np.zeros((256, 13))
    sliding[:, 0], sliding[:, 6], sliding[:, 10] = 1.0, env.task.height, 0.5
    sliding[:128, 10] = 0.0  # the others rest
    env.set_object_states(sliding, np.tile([0.2, 0.2, 0.1], (256, 1)))
    env.advance(np.zeros((256, 3)))
    v = env.run.object_state[:, 10:13]
    assert np.abs(v[:128]).max() < 1e-3
    slower = 0.5 - 0.1 * 9.81 * env.setup.twin.theta["friction_floor"].value
    assert v[128:].mean(0) == pytest.approx([slower, 0.0, 0.0], abs=0.02)
    assert v[128:].std(0) == pytest.approx(np.full(3, 0.03 * slower), rel=0.2)
    assert TrainingWorlds("push_t", num_worlds=1).worlds("state").worlds.disturbance == 0.0


def test_an_episode_in_which_the_pusher_pinches_the_object_has_failed():
    worlds = TrainingWorlds("flip_mug", training_options(), num_worlds=2, domains=CousinDomains(0.0))
    env = worlds.task_worlds("state").worlds
    place = StartDistribution(env.setup).middle()
    heights = np.array([[0.0, 0.0, 0.055], [0.0, 0.0, 0.155]])  # the pusher touches it from above, or is far from it
    p_WP = place.X_WO.translation() + heights
    env.set_object_states(np.tile(place.object_state, (2, 1)), p_WP)
    out = env.advance(np.tile([0.0, 0.0, -0.3], (2, 1)))
    assert out.terminated.tolist() == [True, False]
    assert list(out.failures) == [0]
    assert "mean force over 50.0 N" in out.failures[0]
    assert not out.progress.success.any()


def test_images_in_a_training_of_flips_have_a_light_of_their_own_in_each_episode_that_a_resumed_one_keeps():
    worlds = TrainingWorlds("flip_cube", training_options(image_size=48), num_worlds=3, domains=CousinDomains(0.0))
    env = worlds.task_worlds("rgb_state")
    env.seed(0)
    env.set_options({"place": StartDistribution(env.worlds.setup).middle()})
    first = env.reset()["image"].astype(float)
    shown = (first < 250.0).all(0)
    assert np.ptp(first[:, shown].mean(1)) > 10.0  # cubes of one colour in one place
    kept = env.worlds.get_state()
    other = worlds.task_worlds("rgb_state")
    other.reset()
    other.worlds.set_state(kept)
    np.testing.assert_array_equal(other.worlds.run.images(), env.worlds.run.images())
    assert worlds.about["light"] == 0.6
    assert "light" not in TrainingWorlds("push_t", num_worlds=1).about
    assert Worlds("flip_cube", "twin", 1).light == 0.0
