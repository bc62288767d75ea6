# SPDX-License-Identifier: MIT
"""Policies for tests, without a network."""

from dataclasses import dataclass, replace
from functools import cache

import numpy as np

from pinwm_drake.learning.spec import PolicySpec
from pinwm_drake.systems.envs.options import EnvOptions
from pinwm_drake.systems.envs.policy_scene import policy_spec
from pinwm_drake.systems.scenario.schema import View
from pinwm_drake.systems.scenario.setup import Setup, make_setup
from tests.systems.stations import action_setup, scenario

LONGEST, SIZE = 0.02, 32  # m, px


@cache
def small_setup(updates: int = 1) -> Setup:
    """A T-block, small images, and 1 or 24 updates of the state in an action."""
    small = replace(scenario(), camera=View(width=SIZE, height=SIZE))
    return action_setup(small) if updates == 1 else make_setup(small)


def spec_of(setup: Setup, frames: int = 2) -> PolicySpec:
    return policy_spec(setup, EnvOptions(frames=frames, max_translation=LONGEST), "rgb")


@dataclass(eq=False)
class Follower:
    """Goes to where the object is seen, and a little ahead of where it has moved from; counts what it is asked."""

    spec: PolicySpec
    asked: int = 0

    def action(self, image: np.ndarray, p_WP: np.ndarray) -> np.ndarray:
        """(2,) within [-1, 1]^2."""
        last, first = middle(image[..., -3:]), middle(image[..., :3])
        return np.clip((last + 2.0 * (last - first) - p_WP) / LONGEST, -1.0, 1.0)

    def act(self, image: np.ndarray, p_WP: np.ndarray) -> np.ndarray:
        """(2,) m, shortened as `Task.translation` does it, to the last bit."""
        assert image.shape == self.spec.image_shape
        assert image.dtype == np.uint8
        assert p_WP.shape == (2,)
        self.asked += 1
        action = self.action(image, p_WP)
        return LONGEST * action / max(np.hypot(*action), 1.0)


def middle(rgb: np.ndarray) -> np.ndarray:
    """Roughly where what is not white lies, x and y, m."""
    dark = 255.0 - rgb.mean(axis=2)
    height, width = dark.shape
    x, y = np.arange(width) - 0.5 * width, 0.5 * height - np.arange(height)
    return 0.5 / width * np.array([dark.sum(axis=0) @ x, dark.sum(axis=1) @ y]) / max(dark.sum(), 1.0)
