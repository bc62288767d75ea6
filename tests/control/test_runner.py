# SPDX-License-Identifier: MIT
"""A bundle at a caller's pace: frames, the pusher's place by stamps, limits, faults and the end."""

import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

from pinwm_drake.control import runner as module
from pinwm_drake.control.runner import Runner
from pinwm_drake.errors import StateError
from pinwm_drake.learning.bundle import read_bundle
from pinwm_drake.learning.safety import default_limits
from tests.learning.bundles import exported, image_spec, untrained_policy

pytestmark = pytest.mark.usefixtures("read_operators_once")

ROOT = Path(__file__).resolve().parents[2]
H = 0.1


class Seen:
    """Stands for a bundle: keeps what it is shown, and answers what it is told to."""

    def __init__(self, spec):
        self.spec, self.limits = spec, default_limits(spec)
        self.stacks, self.places, self.d_W, self.state = [], [], np.array([0.01, 0.0]), None

    def step(self, image, p_WP):
        self.stacks.append(image[0, 0, ::3].tolist())
        self.places.append(p_WP.copy())
        return self.d_W, self.state


@pytest.fixture
def seen(monkeypatch):
    bundle = Seen(image_spec(16, 3))
    monkeypatch.setattr(module, "Bundle", Seen)
    return bundle


def picture(shade):
    image = np.full((16, 16, 3), 255, np.uint8)
    image[0, 0] = shade
    image[6:10, 6:10] = 100
    return image


def give(runner, t, shade, p_WP, late=0.0):
    runner.pusher(t, p_WP)
    runner.image(t - late, picture(shade))
    return runner.command(t)


def at(x):
    return np.array([x, 0.0, 0.02])


def test_frames_are_stacked_in_order_one_an_action_and_places_are_of_the_images_time(seen):
    runner = Runner(seen)
    for k in range(31):
        t = k / 100
        # It moves at 0.1 m/s; images are 40 ms late.
        give(runner, t, k, at(0.1 * t), late=0.04)
    assert seen.stacks == [[0, 0, 0], [0, 0, 10], [0, 10, 20], [10, 20, 30]]
    # Of the first image's time nothing is known: the earliest place stands for it.
    np.testing.assert_allclose([place[0] for place in seen.places], [0.0, 0.006, 0.016, 0.026], atol=1e-12)


def test_nothing_moves_until_it_is_armed_and_limits_are_kept(seen):
    runner = Runner(seen)
    with pytest.raises(StateError, match="no image and no position of the pusher has come yet"):
        runner.arm()
    np.testing.assert_array_equal(give(runner, 0.0, 1, at(0.0)).velocity, np.zeros(3))
    runner.arm()
    seen.d_W = np.array([0.5, 0.0])
    command = give(runner, H, 2, at(0.0))
    assert command.state == "running"
    assert np.linalg.norm(command.velocity) <= seen.limits.max_speed * (1 + 1e-9)
    assert not command.done


def test_it_ends_at_the_goal_by_the_estimate_and_after_its_last_action(seen):
    runner, t = Runner(seen), 0.0
    give(runner, t, 1, at(0.0))
    runner.arm()
    for k in range(1, seen.spec.max_steps + 1):
        t = k * H
        command = give(runner, t, k % 200, at(0.0))
        assert command.state == "running"
    command = give(runner, t + H, 7, at(0.0))
    assert command.done
    assert command.state == "done"
    assert "as many as in training" in command.reason
    np.testing.assert_array_equal(command.velocity, np.zeros(3))
    with pytest.raises(StateError, match="the controller is done"):
        runner.arm()
    runner.reset()
    give(runner, 0.0, 1, at(0.0))
    runner.arm()
    seen.state = np.zeros(11)
    seen.state[2] = 1.0
    states = [give(runner, k * H, k, at(0.0)) for k in range(1, 5)]
    assert [one.state for one in states] == ["running"] * 3 + ["done"]
    assert states[-1].reason == "at the goal, by the policy's estimate"
    np.testing.assert_array_equal(states[-1].estimate, seen.state)


@pytest.mark.parametrize(
    ("wrong", "words"),
    [
        (lambda runner, t: runner.image(t, np.full((16, 16, 3), 255, np.uint8)), "image is blind"),
        (lambda runner, t: runner.image(t, picture(3)[:8]), "image has 16 by 8 px; allowed: 16 by 16"),
        (lambda runner, t: runner.image(t, picture(3) / 255.0), "image is float64"),
        (lambda runner, t: runner.pusher(t, at(np.nan)), "pusher's state is lost"),
        (lambda runner, t: runner.pusher(t, at(5.0)), "outside of its box"),
        (lambda runner, t: runner.image(t + 1.0, picture(3)), "image is from the future"),
        (lambda runner, t: runner.image(t, picture(2)), "image is frozen"),
    ],
)
def test_faults_latch_between_actions_until_a_reset(seen, wrong, words):
    runner = Runner(seen)
    give(runner, 0.0, 1, at(0.0))
    runner.arm()
    assert give(runner, H, 2, at(0.0)).state == "running"
    runner.pusher(H + 0.02, at(0.0))
    runner.image(H + 0.02, picture(30))
    wrong(runner, H + 0.02)
    command = runner.command(H + 0.02)
    assert command.state == "latched"
    assert words in command.reason
    for k in range(2, 5):
        command = give(runner, k * H, 10 + k, at(0.0))
        assert command.state == "latched"
        np.testing.assert_array_equal(command.velocity, np.zeros(3))


def test_silence_of_camera_and_robot_latches(seen):
    for name in ("image", "pusher"):
        runner = Runner(seen)
        give(runner, 0.0, 1, at(0.0))
        runner.arm()
        give(runner, H, 2, at(0.0))
        for k in range(1, 30):
            t = H + 0.01 * k
            if name == "image":
                runner.pusher(t, at(0.0))
            else:
                runner.image(t, picture(k))
            command = runner.command(t)
        assert command.state == "latched"
        assert name in command.reason
        assert "stale" in command.reason or "none has come" in command.reason


def test_a_repeated_image_is_not_stacked_twice(seen):
    runner = Runner(seen)
    give(runner, 0.0, 1, at(0.0))
    runner.pusher(0.09, at(0.0))
    runner.command(0.1)
    assert seen.stacks == [[1, 1, 1]]


def test_places_and_translations_before_the_last_actions_follow_the_place(monkeypatch):
    seen = Seen(image_spec(16, 3, history=2))
    monkeypatch.setattr(module, "Bundle", Seen)
    runner = Runner(seen)
    for k in range(2):  # not armed: nothing has been asked for
        give(runner, k * H, 1 + k, at(0.01 * k))
        assert seen.places[-1].tolist() == pytest.approx([0.01 * k, 0, 0.01 * k, 0, 0, 0, 0.01 * k, 0, 0, 0])
    runner.arm()
    first, second = [0.02, 0, 0.01, 0], [0.03, 0, 0, 0.02]
    rest = [0.02, 0, 0, 0]
    for k, (x, past) in enumerate([(0.02, rest + rest), (0.03, first + rest), (0.05, second + first)]):
        seen.d_W = np.array([0.01, 0.0]) if k == 0 else np.array([0.0, 0.02])
        give(runner, (2 + k) * H, 5 + k, at(x))
        assert seen.places[-1].tolist() == pytest.approx([x, 0, *past])
    runner.reset()
    give(runner, 9.0, 9, at(0.0))
    assert seen.places[-1].tolist() == pytest.approx([0.0] * 10)


def test_a_real_bundle_answers_as_it_does_itself(tmp_path):
    folder = exported(tmp_path / "bundle", untrained_policy(image_spec(16, 2)))
    bundle, runner = read_bundle(folder), Runner(folder)
    give(runner, 0.0, 1, at(0.0))
    runner.arm()
    command = give(runner, H, 2, at(0.05))
    stack = np.concatenate([picture(1), picture(2)], axis=2)
    expected = bundle.act(stack, np.array([0.05, 0.0])) / H
    np.testing.assert_allclose(command.velocity[:2], expected, atol=1e-9)


# What docs/how-to/own-robot.md installs beside the wheel, and what these packages bring themselves.
INSTALLED = (
    "numpy onnx google ml_dtypes onnxruntime yaml pydantic pydantic_core annotated_types typing_inspection "
    "typing_extensions lazy_loader"
)
ALONE = f"""
import sys
from importlib.machinery import PathFinder

class Alone:
    @staticmethod
    def find_spec(name, path=None, target=None):
        top = name.partition(".")[0]
        found = None if top in {INSTALLED.split()!r} else PathFinder.find_spec(top)
        if found is not None and "site-packages" in str(found.origin):
            raise ModuleNotFoundError(f"No module named {{name!r}}", name=name)

sys.meta_path.insert(0, Alone)
import pinwm_drake as pw
print(pw.Runner("push_t").bundle.spec.task.name, pw.Runner("flip_mug").bundle.spec.task.name)
"""


def test_it_needs_only_the_packages_of_the_how_to():
    page = (ROOT / "docs/how-to/own-robot.md").read_text()
    assert "pip install numpy onnx onnxruntime pyyaml pydantic lazy-loader" in page
    found = subprocess.run([sys.executable, "-c", ALONE], capture_output=True, text=True, check=True)
    assert found.stdout.split() == ["push", "flip"]
