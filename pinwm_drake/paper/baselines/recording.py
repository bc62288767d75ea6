"""Recording of episodes, one of each world, with all that was seen and done."""

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np
from stable_baselines3.common.vec_env import VecEnv

from pinwm_drake.learning.world_evaluation import usual_starts

Act = Callable[[Any, np.ndarray], np.ndarray]
"""Called with an observation and where episodes begin, (W,) bool; gives actions (W, n) in [-1, 1]."""


@dataclass(frozen=True, eq=False)
class Recorded:
    """One episode of T actions.

    Attributes:
        images: (T + 1, height, width, 3) uint8, RGB: what was seen before each action, and at the end.
        pusher: (T + 1, n) float32, position of the pusher along the task's axes across its box, -1 to 1.
        actions: (T, n) float32 in [-1, 1].
        rewards: (T,) float32.
        info: What the world said at the end, as SB3's `infos` have it.
    """

    images: np.ndarray
    pusher: np.ndarray
    actions: np.ndarray
    rewards: np.ndarray
    info: dict[str, Any]


def record_episodes(env: VecEnv, act: Act, seed: int) -> list[Recorded]:
    """Records one episode of each world; all begin where the scene says.

    Args:
        env: Worlds whose observation has `image`, whose last three channels are kept, and `pusher`.
        act: Function that acts.
        seed: Seed of the first world; world k has `seed + k`.

    Returns:
        The episodes, in the order of the worlds.
    """
    with usual_starts(env):
        env.seed(seed)
        return _recorded(env, act)


def _recorded(env: VecEnv, act: Act) -> list[Recorded]:
    W = env.num_envs
    seen: Any = env.reset()
    images, pushers = [[_last(one)] for one in seen["image"]], [[one.copy()] for one in seen["pusher"]]
    taken: list[list[np.ndarray]] = [[] for _ in range(W)]
    rewards: list[list[float]] = [[] for _ in range(W)]
    found: dict[int, Recorded] = {}
    begins = np.ones(W, bool)
    while len(found) < W:
        actions = np.clip(act(seen, begins), -1.0, 1.0).astype(np.float32)
        seen, gained, begins, infos = env.step(actions)
        for world in range(W):
            if world in found:
                continue
            last = infos[world]["terminal_observation"] if begins[world] else None
            image, pusher = (seen[name][world] if last is None else last[name] for name in ("image", "pusher"))
            images[world].append(_last(image))
            pushers[world].append(pusher.copy())
            taken[world].append(actions[world].copy())
            rewards[world].append(float(gained[world]))
            if last is not None:
                found[world] = Recorded(
                    np.stack(images[world]),
                    np.stack(pushers[world]).astype(np.float32),
                    np.stack(taken[world]),
                    np.array(rewards[world], np.float32),
                    infos[world],
                )
    return [found[world] for world in range(W)]


def _last(image: np.ndarray) -> np.ndarray:
    """The last image (height, width, 3) of a stack, copied."""
    return image[..., -3:].copy()
