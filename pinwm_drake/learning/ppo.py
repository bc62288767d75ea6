"""PPO of SB3 on a task, from the state or from images, in rounds."""

import math
from collections.abc import Mapping
from dataclasses import asdict, dataclass
from pathlib import Path

import numpy as np
import torch
from stable_baselines3.common.logger import configure
from stable_baselines3.common.utils import ConstantSchedule, set_random_seed
from stable_baselines3.common.vec_env import VecEnv
from torch import nn

from pinwm_drake.errors import ParameterError
from pinwm_drake.learning.actor_critic import ActorCritic, Augmented, Ppo
from pinwm_drake.learning.actors import ImageActor
from pinwm_drake.learning.heading import AlongHeading
from pinwm_drake.learning.images.augment import Augment
from pinwm_drake.learning.images.bfloat16 import has_bfloat16
from pinwm_drake.learning.images.estimated import Estimated, Regression
from pinwm_drake.learning.option_checks import check_options
from pinwm_drake.learning.policy import Policy, make_actor
from pinwm_drake.learning.progress import Report, silent
from pinwm_drake.learning.round_callback import Arrays, RoundCallback, begin_round
from pinwm_drake.learning.rounds import ANY, EVALUATION_SEED, OnRound, Rounds, Until
from pinwm_drake.learning.spec import PolicySpec
from pinwm_drake.learning.toward_goal import TowardGoal
from pinwm_drake.learning.weights import pack, unpack
from pinwm_drake.learning.world_evaluation import evaluate_worlds
from pinwm_drake.tasks.history import begun
from pinwm_drake.tasks.waypoints import Waypoints

_NEVER = 1 << 30
_IMAGES = 256  # in an update of estimates
_ESTIMATION = "estimation/"


@dataclass(frozen=True)
class PpoOptions:
    """Settings of PPO, as SB3 names them.

    Attributes:
        steps: Number of steps of all worlds together; rounded up to whole rounds.
        round_steps: Number of steps of all worlds in a round; rounded up to whole rollouts. An evaluation follows.
        n_steps: Number of steps of each world in a rollout.
        batch_size: Number of steps in an update; all of a rollout where that is less.
        n_epochs: Number of passes over a rollout.
        learning_rate: Learning rate of Adam at first.
        last_share: Share of the learning rate that is left at the end; it falls evenly from round to round.
        gamma: Discount of an action.
        gae_lambda: Lambda of the generalised advantage estimate.
        clip_range: Range by which PPO clips the ratio of probabilities.
        shift: px, largest random shift of the images as the policy sees them.
        gain: Relative half-width of the random factors of their colours.
        entropy: Weight of the actions' entropy in the objective.
        value: Weight of the critic's loss in the objective; actor and critic share nothing but the bound of the
            gradient's norm.
        imitation: Number of updates by the actions that are shown, where there are any.
        auxiliary: Number of passes over a rollout's images by which an estimate of the state is learned, on which a
            policy of images acts; 0 learns from images to actions by the reward alone.
        auxiliary_rate: Learning rate of that at first; it falls as the other one does.
        episodes: Number of episodes in an evaluation.
        patience: Number of rounds with hardly shorter episodes in their evaluation than one before them, which mostly
            succeeded, after which the training ends.

    Raises:
        ParameterError: A number is out of range.
    """

    steps: int = 3_000_000
    round_steps: int = 100_000
    n_steps: int = 64
    batch_size: int = 512
    n_epochs: int = 10
    learning_rate: float = 5e-4
    last_share: float = 0.1
    gamma: float = 0.98
    gae_lambda: float = 0.95
    clip_range: float = 0.2
    shift: int = 0
    gain: float = 0.0
    entropy: float = 0.0
    value: float = 0.05
    imitation: int = 500
    auxiliary: int = 0
    auxiliary_rate: float = 1e-3
    episodes: int = 128
    patience: int = 3

    @classmethod
    def for_images(cls, *, auxiliary: bool = True) -> "PpoOptions":
        """Settings for policies of images.

        Args:
            auxiliary: Flag: the policy acts on an estimate of the state, which is learned beside it. Otherwise updates
                are smaller: with a learning rate of 0.0005 and six epochs of a rollout half as long, the divergence
                (KL) of an update was 0.12 to 0.20, and the entropy fell while success did not grow; with these it is
                0.02 to 0.04.
        """
        if auxiliary:
            return cls(steps=4_000_000, auxiliary=1, gain=0.2)
        return cls(steps=4_000_000, n_steps=128, n_epochs=4, learning_rate=2e-4, value=0.5, shift=1, gain=0.2)

    def __post_init__(self) -> None:
        """Checks the values."""
        check_options(self, ("shift", "gain", "entropy", "imitation", "auxiliary"))


def train_ppo(
    env: VecEnv,
    spec: PolicySpec,
    folder: Path,
    options: PpoOptions,
    *,
    stage: str,
    seed: int = 0,
    about: Mapping[str, object] | None = None,
    shown: Waypoints | None = None,
    on_round: OnRound | None = None,
    resume: bool = False,
    until: Until = ANY,
    device: str = "cpu",
    report: Report = silent,
) -> Policy:
    """Trains a policy; the best by its evaluations is kept in the checkpoint.

    Args:
        env: Worlds; observation "state" for a policy of the state, "rgb_state" for one of images: the critic sees the
            state in any case.
        spec: Specification of the policy.
        folder: Folder of checkpoints, `history.csv` and TensorBoard's events.
        options: Settings of PPO.
        stage: Name of the stage in progress and messages.
        seed: Seed of networks and worlds, 0 or more.
        about: Description of the worlds, as JSON takes it: a checkpoint with another one is refused.
        shown: Actions in states, which a policy of the state imitates before it is trained; None, or none of them, to
            begin with weights drawn at random.
        on_round: Called with a seed before worlds are reset at the beginning of a round, to draw its domains.
        resume: Flag: the training goes on from a checkpoint, where there is one.
        until: What ends it before its last round.
        device: Device of the networks, as torch names it; the policy that is returned is on the CPU.
        report: Called with the progress of the training.

    Returns:
        The best policy, by its evaluations.

    Raises:
        ParameterError: The policy is one of images with a history.
        InputError: A checkpoint cannot be used, or a file cannot be written.
    """
    if spec.observes == "rgb" and spec.history:
        raise ParameterError(f"history: got {spec.history} for PPO from images; allowed: 0, or a teacher of the state")
    told = {"options": asdict(options), "seed": seed, "spec": spec.to_document(), "worlds": env.num_envs}
    rollout = options.n_steps * env.num_envs
    size = rollout * math.ceil(min(options.round_steps, options.steps) / rollout)
    total = math.ceil(options.steps / size)
    about = {**told, **(about or {})}
    rounds = Rounds(folder, stage, about, seed, resume=resume, total=total, until=until, report=report)
    # An evaluation is of the world's actions, by the goals that are seen; what learns acts towards the task's own goal.
    drawn = spec.observes == "rgb" and spec.task.goal_size > 0
    worlds = TowardGoal(env, spec.task) if drawn else env
    learner = _Learner(worlds, spec, options, seed, device)
    model = learner.model
    model.set_logger(configure(str(folder / "tensorboard"), ["tensorboard"]))
    if rounds.number:
        learner.unpack(rounds.arrays)
    elif shown is not None and len(shown):
        state = spec.task.state(shown.object_state, shown.p_WP)
        if spec.history:  # episodes begin there too
            state = begun(state, spec.action_size, spec.history)
        action = torch.from_numpy(shown.action.astype(np.float32))
        learner.policy.imitate(torch.from_numpy(state), action, updates=options.imitation, seed=seed)
    while not rounds.ended(options.patience):
        rounds.begin(worlds, on_round)
        learner.set_rate(rounds.falling(options.last_share))
        kept = rounds.restore(worlds)
        if kept is not None:
            learner.unpack(kept)
        done = begin_round(model, rounds, kept)
        callback = RoundCallback(rounds, worlds, size, learner.pack, loss="train/value_loss")
        callbacks = [callback, *learner.regression]
        model.learn(size - done, callback=callbacks, reset_num_timesteps=False, log_interval=_NEVER)
        loss = float(model.logger.name_to_value.get("train/value_loss", math.nan))
        now = learner.network()
        found = evaluate_worlds(env, Policy(spec, now), options.episodes, seed=EVALUATION_SEED)
        rounds.end(learner.pack(), now, found, steps=size, loss=loss, logger=model.logger)
    return Policy(spec, rounds.best_actor(spec))


class _Learner:
    """SB3's PPO of a policy and, where it acts on estimates, the regression of these.

    Attributes:
        model: SB3's algorithm.
        regression: The regression's callback, or none.
    """

    def __init__(self, env: VecEnv, spec: PolicySpec, options: PpoOptions, seed: int, device: str) -> None:
        """Draws all weights from a seed."""
        set_random_seed(seed)
        self._actor, self._options = make_actor(spec).to(device), options
        self.regression: list[Regression] = []
        acts = self._actor
        if isinstance(self._actor, ImageActor):
            self._actor.mixed_precision = has_bfloat16(device)
        if isinstance(self._actor, ImageActor) and options.auxiliary:
            env = worlds = Estimated(env, self._actor, options.n_steps)
            acts = self._actor.actor
            self._optimizer = torch.optim.Adam(self._actor.estimation(), options.auxiliary_rate)
            self.regression = [
                Regression(
                    worlds,
                    self._actor,
                    self._optimizer,
                    Augment(options.shift, options.gain),
                    epochs=options.auxiliary,
                    batch_size=_IMAGES,
                )
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
            seed=seed,
            device=device,
            policy_kwargs={"actor": acts},
        )

    @property
    def policy(self) -> ActorCritic:
        """Actor and critic."""
        assert isinstance(self.model.policy, ActorCritic)
        return self.model.policy

    def network(self) -> nn.Module:
        """The network of the policy, with its present weights."""
        self.policy.pull()
        return self._actor.eval()

    def set_rate(self, share: float) -> None:
        """Sets all learning rates to a share of those at first."""
        self.model.lr_schedule = ConstantSchedule(share * self._options.learning_rate)
        if self.regression:
            for group in self._optimizer.param_groups:
                group["lr"] = share * self._options.auxiliary_rate

    def pack(self) -> Arrays:
        """All that is learned, with the optimizers, as arrays."""
        arrays = pack(self.policy, self.policy.optimizer)
        if self.regression:
            estimation = pack(self._actor, self._optimizer)
            arrays |= {f"{_ESTIMATION}{name}": values for name, values in estimation.items()}
        return arrays

    def unpack(self, arrays: Mapping[str, np.ndarray]) -> None:
        """Restores the arrays of `pack`."""
        if self.regression:
            names = [name for name in arrays if name.startswith(_ESTIMATION)]
            estimation = {name.removeprefix(_ESTIMATION): arrays[name] for name in names}
            unpack(estimation, self._actor, self._optimizer)
        unpack(arrays, self.policy, self.policy.optimizer)
