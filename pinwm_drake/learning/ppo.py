# SPDX-License-Identifier: MIT
"""PPO of SB3 on a task, from the state or from images, in rounds."""

from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from typing import ClassVar

import numpy as np
import torch
from stable_baselines3.common.callbacks import BaseCallback
from stable_baselines3.common.utils import set_random_seed
from stable_baselines3.common.vec_env import VecEnv
from torch import nn
from torch.optim.swa_utils import AveragedModel

from pinwm_drake.errors import ParameterError
from pinwm_drake.learning.actor_critic import ActorCritic, Augmented, Ppo
from pinwm_drake.learning.actors import ImageActor
from pinwm_drake.learning.heading import AlongHeading
from pinwm_drake.learning.images.augment import Augment
from pinwm_drake.learning.images.estimated import Estimated, Regression
from pinwm_drake.learning.options import RewardOptions
from pinwm_drake.learning.policy import Policy, make_actor
from pinwm_drake.learning.round_callback import Arrays, Learner
from pinwm_drake.learning.rounds import Rounds, StageRun
from pinwm_drake.learning.spec import PolicySpec
from pinwm_drake.learning.weights import has_bfloat16, pack, set_weights, unpack, weights
from pinwm_drake.learning.worlds import TowardGoal
from pinwm_drake.tasks.history import begun
from pinwm_drake.tasks.waypoints import Waypoints

_IMAGES = 256  # in an update of estimates
_ESTIMATION, _MEAN = "estimation/", "mean/"


@dataclass(frozen=True)
class PpoOptions(RewardOptions):
    """Settings of PPO, as SB3 names them; an update has all of a rollout where that is less than the batch size.

    Attributes:
        n_steps: Number of steps of each world in a rollout.
        n_epochs: Number of passes over a rollout.
        gae_lambda: Lambda of the generalised advantage estimate.
        clip_range: Range by which PPO clips the ratio of probabilities.
        shift: px, largest random shift of the images as the policy sees them.
        gain: Relative half-width of the random factors of their colours.
        entropy: Weight of the actions' entropy in the objective.
        value: Weight of the critic's loss in the objective; actor and critic share nothing but the bound of the
            gradient's norm.
        averaged: Share that the mean of a policy's weights keeps at each rollout, less at first. The mean of a policy
            of the state is what is evaluated and kept: single updates fit it to contacts of this engine alone. 0, and
            a policy of images, take the last weights.
        imitation: Number of updates by the actions that are shown, where there are any.
        auxiliary: Number of passes over a rollout's images by which an estimate of the state is learned, on which a
            policy of images acts; 0 learns from images to actions by the reward alone.
        auxiliary_rate: Learning rate of that at first; it falls as the other one does.
    """

    may_be_zero: ClassVar[tuple[str, ...]] = ("shift", "gain", "entropy", "averaged", "imitation", "auxiliary")
    up_to_one: ClassVar[tuple[str, ...]] = ("averaged",)

    steps: int = 3_000_000
    round_steps: int = 100_000
    learning_rate: float = 5e-4
    gamma: float = 0.98
    patience: int = 3
    n_steps: int = 64
    n_epochs: int = 10
    gae_lambda: float = 0.95
    clip_range: float = 0.2
    shift: int = 0
    gain: float = 0.0
    entropy: float = 0.0
    value: float = 0.05
    averaged: float = 0.85
    imitation: int = 1500
    auxiliary: int = 0
    auxiliary_rate: float = 1e-3

    @classmethod
    def for_images(cls, *, auxiliary: bool = True) -> "PpoOptions":
        """Return settings for policies of images.

        Args:
            auxiliary: Flag: the policy acts on an estimate of the state, which is learned beside it. Otherwise updates
                are smaller: with a learning rate of 0.0005 and six epochs of a rollout half as long, the divergence
                (KL) of an update was 0.12 to 0.20, and the entropy fell while success did not grow; with these it is
                0.02 to 0.04.
        """
        images = cls(steps=4_000_000, averaged=0.0)
        if auxiliary:
            return replace(images, auxiliary=1, gain=0.2)
        return replace(images, n_steps=128, n_epochs=4, learning_rate=2e-4, value=0.5, shift=1, gain=0.2)


def train_ppo(
    env: VecEnv, spec: PolicySpec, options: PpoOptions, run: StageRun, *, shown: Waypoints | None = None
) -> Policy:
    """Trains a policy; the best by its evaluations is kept in the checkpoint.

    Args:
        env: Worlds; observation "state" for a policy of the state, "rgb_state" for one of images: the critic sees the
            state in any case.
        spec: Specification of the policy.
        options: Settings of PPO.
        run: The run.
        shown: Actions in states, which a policy of the state imitates before it is trained; None, or none of them, to
            begin with weights drawn at random.

    Returns:
        The best policy, by its evaluations.

    Raises:
        ParameterError: The policy is one of images with a history.
        InputError: A checkpoint cannot be used, or a file cannot be written.
    """
    if spec.observes == "rgb" and spec.history:
        raise ParameterError(f"history: got {spec.history} for PPO from images; allowed: 0, or a teacher of the state")
    # An evaluation is of the world's actions, by the goals that are seen; what learns acts towards the task's own goal.
    drawn = spec.observes == "rgb" and spec.task.goal_size > 0
    worlds = TowardGoal(env, spec.task) if drawn else env
    return _Learner(worlds, spec, options, run, shown).train(env, worlds, options.n_steps * env.num_envs, run)


class MeanWeights(BaseCallback):
    """Mean of an actor's weights over the last rollouts.

    Source: Polyak and Juditsky, "Acceleration of stochastic approximation by averaging" (1992).
    """

    def __init__(self, pull: Callable[[], nn.Module], most: float) -> None:
        """Begin with the weights as they are.

        Args:
            pull: Returns the actor with its present weights.
            most: Share that the mean keeps at a rollout, at the most: the first n rollouts count alike.
        """
        super().__init__()
        self._pull, least = pull, 1.0 - most
        self.mean = AveragedModel(pull(), avg_fn=lambda mean, new, n: mean + max(least, 1.0 / (n + 1)) * (new - mean))

    def _on_rollout_end(self) -> None:
        self.mean.update_parameters(self._pull())

    def _on_step(self) -> bool:
        return True


class _Learner(Learner):
    """SB3's PPO of a policy and, where it acts on estimates, the regression of these."""

    loss = "train/value_loss"
    _estimates = False
    model: Ppo
    options: PpoOptions

    def __init__(
        self, env: VecEnv, spec: PolicySpec, options: PpoOptions, run: StageRun, shown: Waypoints | None
    ) -> None:
        set_random_seed(run.seed)
        self.spec, self.options, self._seed, self._shown = spec, options, run.seed, shown
        device = run.device
        self._actor = acts = make_actor(spec).to(device)
        self._mean: MeanWeights | None = None
        if isinstance(self._actor, ImageActor):
            self._actor.mixed_precision = has_bfloat16(device)
        if isinstance(self._actor, ImageActor) and options.auxiliary:
            env = worlds = Estimated(env, self._actor, options.n_steps)
            self._estimates = True
            acts = self._actor.actor
            self._optimizer = torch.optim.Adam(self._actor.estimation(), options.auxiliary_rate)
            augment, epochs = Augment(options.shift, options.gain), options.auxiliary
            self.callbacks = [
                Regression(worlds, self._actor, self._optimizer, augment, epochs=epochs, batch_size=_IMAGES)
            ]
        elif isinstance(self._actor, ImageActor):
            env = Augmented(env, Augment(options.shift, options.gain))
        self.model = Ppo(
            ActorCritic,
            AlongHeading(env, spec.task),
            n_steps=options.n_steps,
            batch_size=min(options.batch_size, options.n_steps * env.num_envs),
            n_epochs=options.n_epochs,
            learning_rate=options.learning_rate,
            gamma=options.gamma,
            gae_lambda=options.gae_lambda,
            clip_range=options.clip_range,
            ent_coef=options.entropy,
            vf_coef=options.value,
            seed=run.seed,
            device=device,
            policy_kwargs={"actor": acts},
        )
        if options.averaged and not isinstance(self._actor, ImageActor):
            self._mean = MeanWeights(self._policy.pull, options.averaged)
            self.callbacks = [self._mean]

    @property
    def _policy(self) -> ActorCritic:
        assert isinstance(self.model.policy, ActorCritic)
        return self.model.policy

    def network(self) -> nn.Module:
        self._policy.pull()
        actor: nn.Module = self._actor if self._mean is None else self._mean.mean.module
        return actor.eval()

    def set_rate(self, share: float) -> None:
        super().set_rate(share)
        if self._estimates:
            for group in self._optimizer.param_groups:
                group["lr"] = share * self.options.auxiliary_rate

    def pack(self) -> Arrays:
        arrays = pack(self._policy, self._policy.optimizer)
        if self._estimates:
            estimation = pack(self._actor, self._optimizer)
            arrays |= {f"{_ESTIMATION}{name}": values for name, values in estimation.items()}
        if self._mean is not None:
            arrays |= {f"{_MEAN}{name}": values for name, values in weights(self._mean.mean).items()}
        return arrays

    def unpack(self, arrays: Mapping[str, np.ndarray]) -> None:
        if self._estimates:
            unpack(_named(arrays, _ESTIMATION), self._actor, self._optimizer)
        if self._mean is not None:
            set_weights(self._mean.mean, _named(arrays, _MEAN))
        unpack(arrays, self._policy, self._policy.optimizer)

    def prepare(self, rounds: Rounds) -> None:
        if rounds.number or self._shown is None or not len(self._shown):
            return
        state = self.spec.task.state(self._shown.object_state, self._shown.p_WP)
        if self.spec.history:  # episodes begin there too
            known = self._shown.past.shape[1] >= self.spec.history
            state = begun(state, self.spec.action_size, self.spec.history, self._shown.past if known else None)
        action = torch.from_numpy(self._shown.action.astype(np.float32))
        self._policy.imitate(torch.from_numpy(state), action, updates=self.options.imitation, seed=self._seed)


def _named(arrays: Mapping[str, np.ndarray], prefix: str) -> Arrays:
    return {name.removeprefix(prefix): array for name, array in arrays.items() if name.startswith(prefix)}
