# SPDX-License-Identifier: MIT
"""An actor and a critic as SB3's PPO wants them; the critic may see more than the actor."""

from collections.abc import Mapping
from typing import Any, cast

import numpy as np
import torch
from gymnasium import spaces
from stable_baselines3 import PPO
from stable_baselines3.common.policies import ActorCriticPolicy
from stable_baselines3.common.torch_layers import BaseFeaturesExtractor
from stable_baselines3.common.type_aliases import GymEnv
from stable_baselines3.common.vec_env import VecEnv
from torch import Tensor, nn
from torch.nn.functional import cross_entropy

from pinwm_drake.learning.actors import LEVELS, Seen, level_shares
from pinwm_drake.learning.images.augment import Augment
from pinwm_drake.learning.images.estimated import TRUTH
from pinwm_drake.learning.worlds import SeenWorlds

_RATE, _BATCH = 1e-3, 256  # of imitation
_WIDTH = 256  # of the critic's hidden layers


class _AsSeen(BaseFeaturesExtractor):
    """Extractor that hands the observation on: actor and critic have extractors of their own."""

    def __init__(self, observation_space: Any) -> None:
        super().__init__(observation_space, features_dim=1)  # One that is not asked for.

    def forward(self, seen: Tensor) -> Tensor:
        return seen


class _Latents(nn.Module):
    """Last hidden layers of the actor, and of a critic that sees the state."""

    def __init__(self, actor: nn.Module, state_size: int, width: int) -> None:
        super().__init__()
        self.actor: Any = actor
        self.critic = nn.Sequential(nn.Linear(state_size, width), nn.Tanh(), nn.Linear(width, width), nn.Tanh())
        self.latent_dim_pi, self.latent_dim_vf = self.actor.latent_size, width

    def forward(self, seen: Seen) -> tuple[Tensor, Tensor]:
        return self.forward_actor(seen), self.forward_critic(seen)

    def forward_actor(self, seen: Seen) -> Tensor:
        latent: Tensor = self.actor.latent(seen)
        return latent

    def forward_critic(self, seen: Seen) -> Tensor:
        state = seen.get(TRUTH, seen["state"]) if isinstance(seen, Mapping) else seen
        latent: Tensor = self.critic(self.actor.heading.state(state))
        return latent


class ActorCritic(ActorCriticPolicy):
    """`StateActor` or `ImageActor`, whose actions are drawn by their logits, and a critic of the state.

    Source: Pinto et al., "Asymmetric actor critic for image-based robot learning" (RSS 2018), for images.
    """

    def __init__(
        self,
        observation_space: spaces.Space,
        action_space: spaces.Space,
        lr_schedule: Any,
        *,
        actor: nn.Module,
        **unused: Any,
    ) -> None:
        """Take over an actor.

        Args:
            observation_space: Observation space of the worlds.
            action_space: Action space of `ByLevels`: a level's index for each component.
            lr_schedule: Schedule of Adam's learning rate.
            actor: The network; trained in place, from weights that are drawn anew (orthogonal).
            unused: Further arguments that PPO passes to every policy.
        """
        # In a list, as nn.Module takes no module before it is initialised.
        self._given: list[Any] = [actor]
        # SB3's initial values need weights that lie as they are numbered.
        self._given[0].to(memory_format=torch.contiguous_format)
        super().__init__(
            observation_space,
            action_space,
            lr_schedule,
            features_extractor_class=_AsSeen,
            normalize_images=False,
        )
        self._actor.to(memory_format=torch.channels_last)
        self.pull()

    def extract_features(self, obs: Any, features_extractor: BaseFeaturesExtractor | None = None) -> Any:
        """Return the observation as it is: images stay bytes, of which SB3 would make floats."""
        return obs

    def _build_mlp_extractor(self) -> None:
        space: Any = self.observation_space
        state: Any = space["state"] if isinstance(space, spaces.Dict) else space
        self.mlp_extractor = _Latents(self._given[0], state.shape[0], _WIDTH)  # type: ignore[assignment]

    @property
    def _actor(self) -> Any:
        return self._given[0]

    def pull(self) -> nn.Module:
        """Return the actor, with the present weights of its head, which SB3 keeps as `action_net`."""
        head: Any = self.action_net
        self._actor.head.load_state_dict(head.state_dict())
        return self._actor

    def imitate(self, state: Tensor, action: Tensor, *, updates: int, seed: int) -> None:
        """Trains the actor, one of the state, to act as it is shown.

        Source: behaviour cloning, Pomerleau, "ALVINN" (NIPS 1988).

        Args:
            state: (B, state_size) float32, of the world's axes.
            action: (B, n) float32 in [-1, 1], along the world's axes.
            updates: Number of updates.
            seed: Seed of the batches.
        """
        state, action = state.to(self.device), action.to(self.device)
        shares = level_shares(self._actor.heading.along(action, state))
        layers = [*self._actor.body.parameters(), *self.action_net.parameters()]
        optimizer, generator = torch.optim.Adam(layers, lr=_RATE), torch.Generator().manual_seed(seed)
        for _ in range(updates):
            rows = torch.randint(len(state), (_BATCH,), generator=generator)
            logits = self.action_net(self.mlp_extractor.forward_actor(state[rows])).unflatten(1, shares.shape[1:])
            optimizer.zero_grad()
            cross_entropy(logits.flatten(0, 1), shares[rows].flatten(0, 1)).backward()
            optimizer.step()


class ByLevels(SeenWorlds):
    """Worlds that take the index of a level for each component of an action."""

    def __init__(self, env: VecEnv) -> None:
        space: Any = env.action_space
        super().__init__(env, action_space=spaces.MultiDiscrete([len(LEVELS)] * int(space.shape[0])))
        self._levels = np.array(LEVELS, np.float32)

    def step_async(self, actions: np.ndarray) -> None:
        """Begins a step by the actions whose levels have the indices (W, n)."""
        self.venv.step_async(self._levels[actions])


class Augmented(SeenWorlds):
    """Worlds whose images are changed at random as they are seen.

    PPO compares how likely an action is with how likely it was when it was taken, so that both have to see the same.
    """

    def __init__(self, env: VecEnv, augment: Augment) -> None:
        super().__init__(env)
        self._augment = augment

    def seen(self, observation: Any) -> Any:
        """Return the observation with changed images."""
        return {**observation, "image": self._augment.as_images(torch.from_numpy(observation["image"])).numpy()}


class Ppo(PPO):
    """SB3's PPO with actions by levels; images stay as they come: `ImageActor` takes them with the channels last."""

    @staticmethod
    def _wrap_env(env: GymEnv, verbose: int = 0, monitor_wrapper: bool = True) -> VecEnv:
        return ByLevels(cast(VecEnv, env))
