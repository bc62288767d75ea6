# SPDX-License-Identifier: MIT
"""Success of the shipped bundle where its contract is not kept, as a stranger might run it.

    python -m benchmarks.hardening.bundle_mistakes [--episodes 100] [--engine twin]

The episodes are those of `pinwm evaluate push_t --engine twin`, seeds 0 and up.
"""

import argparse
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from pinwm_drake.learning.bundle import Bundle, read_bundle
from pinwm_drake.learning.evaluation import evaluate
from pinwm_drake.systems.envs.policy_scene import spec_environment

Change = Callable[[np.ndarray, np.ndarray], tuple[np.ndarray, np.ndarray]]


def frames(image: np.ndarray) -> np.ndarray:
    """Images (height, width, k, 3) of a stack (height, width, 3 k)."""
    return image.reshape(*image.shape[:2], -1, 3)


def stack(images: np.ndarray) -> np.ndarray:
    """Stack (height, width, 3 k) of images (height, width, k, 3)."""
    return np.ascontiguousarray(images.reshape(*images.shape[:2], -1))


def background(image: np.ndarray, grey: int) -> np.ndarray:
    """Return the stack with the white of its images in a grey."""
    images = frames(image).copy()
    images[(images == 255).all(-1)] = grey
    return stack(images)


MISTAKES: dict[str, Change] = {
    "none": lambda image, pusher: (image, pusher),
    "newest image first": lambda image, pusher: (stack(frames(image)[:, :, ::-1]), pusher),
    "the newest image three times": lambda image, pusher: (stack(frames(image)[:, :, [-1] * 3]), pusher),
    "BGR in place of RGB": lambda image, pusher: (stack(frames(image)[..., ::-1]), pusher),
    "black in place of white": lambda image, pusher: (background(image, 0), pusher),
    "light grey (230) in place of white": lambda image, pusher: (background(image, 230), pusher),
    "x and y of the pusher exchanged": lambda image, pusher: (image, pusher[::-1].copy()),
}


@dataclass
class Mistaken:
    """A bundle to which inputs come as a mistake changes them."""

    bundle: Bundle
    change: Change

    def predict(self, observation, state=None, episode_start=None, deterministic=True):
        """Return the action of the bundle on the changed observation."""
        image, pusher = self.change(observation["image"], observation["pusher"])
        return self.bundle.predict({"image": image, "pusher": pusher})


def main() -> None:
    """Print the table."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--episodes", type=int, default=100)
    parser.add_argument("--engine", default="twin")
    given = parser.parse_args()
    bundle = read_bundle("push_t")
    environment = spec_environment(bundle.spec, "push_t", given.engine)
    print("| mistake | success (95 % interval) | actions |\n| --- | --- | --- |")
    for name, change in MISTAKES.items():
        found = evaluate(environment, Mistaken(bundle, change), range(given.episodes))
        low, high = found.interval
        share = found.successes / given.episodes
        print(f"| {name} | {share:.0%} ({100 * low:.1f} to {100 * high:.1f} %) | {found.mean_steps:.1f} |", flush=True)


if __name__ == "__main__":
    main()
