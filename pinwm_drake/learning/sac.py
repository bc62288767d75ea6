"""SAC of SB3 on a task's state, in rounds."""

import math
from collections.abc import Mapping
from dataclasses import asdict, dataclass
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
import torch
from stable_baselines3 import SAC
from stable_baselines3.common.buffers import ReplayBuffer
from stable_baselines3.common.logger import configure
from stable_baselines3.common.utils import ConstantSchedule
from stable_baselines3.common.vec_env import VecEnv
from torch import nn

from pinwm_drake.checkpoints import generator_state, read_arrays, set_generator_state, write_arrays
from pinwm_drake.errors import InputError, ParameterError
from pinwm_drake.files import prepare_folder
from pinwm_drake.learning.actors import DitherActor
from pinwm_drake.learning.heading import AlongHeading, HeadingExtractor
from pinwm_drake.learning.option_checks import check_options
from pinwm_drake.learning.policy import Policy, make_actor
from pinwm_drake.learning.progress import Report, silent
from pinwm_drake.learning.round_callback import Arrays, RoundCallback, begin_round
from pinwm_drake.learning.rounds import ANY, EVALUATION_SEED, OnRound, Rounds, Until
from pinwm_drake.learning.spec import PolicySpec
from pinwm_drake.learning.weights import pack, set_weights, unpack, weights
from pinwm_drake.learning.world_evaluation import evaluate_worlds

_NEVER = 1 << 30
_TOLD = 20  # actions of each world between two reports
_STORED = ("observations", "next_observations", "actions", "rewards", "dones", "timeouts")
_REPLAY = "replay."


@dataclass(frozen=True)
class SacOptions:
    """Settings of SAC, as SB3 names them.

    Attributes:
        steps: Number of steps of all worlds together; rounded up to whole rounds.
        round_steps: Number of steps of all worlds in a round; rounded up to whole actions. An evaluation follows.
        learning_starts: Number of steps of all worlds with random actions, before anything is learned; at most a
            quarter of all.
        update_every: Number of steps, all worlds together, for each update.
        batch_size: Number of steps in an update.
        buffer_size: Number of steps that are kept to learn from; older ones are forgotten.
        learning_rate: Learning rate of Adam at first, for actor, critics and entropy.
        last_share: Share of the learning rate that is left at the end; it falls evenly from round to round.
        gamma: Discount of an action.
        n_steps: Number of actions whose rewards are added up before the critics' value of the state after them.
        tau: Share of the critics that their slow copies take over in an update.
        entropy: Weight of the entropy at first; it is learned.
        episodes: Number of episodes in an evaluation.
        patience: Number of rounds with hardly shorter episodes in their evaluation than one before them, which mostly
            succeeded, after which the training ends.

    Raises:
        ParameterError: A number is out of range.
    """

    steps: int = 800_000
    round_steps: int = 40_000
    learning_starts: int = 3_200
    update_every: int = 16
    batch_size: int = 512
    buffer_size: int = 1_000_000
    learning_rate: float = 1e-3
    last_share: float = 0.1
    gamma: float = 0.95
    n_steps: int = 3
    tau: float = 0.01
    entropy: float = 0.1
    episodes: int = 128
    patience: int = 5

    def __post_init__(self) -> None:
        """Checks the values."""
        check_options(self, ("learning_starts",))


def train_sac(
    env: VecEnv,
    spec: PolicySpec,
    folder: Path,
    options: SacOptions,
    *,
    stage: str,
    seed: int = 0,
    about: Mapping[str, object] | None = None,
    on_round: OnRound | None = None,
    resume: bool = False,
    until: Until = ANY,
    device: str = "cpu",
    report: Report = silent,
) -> Policy:
    """Trains a policy of the state; the best by its evaluations is kept in the checkpoint.

    Source: Haarnoja et al., "Soft actor-critic: off-policy maximum entropy deep reinforcement learning with a
    stochastic actor" (ICML 2018).

    Args:
        env: Worlds with observation "state".
        spec: Specification of the policy, whose head is "dither".
        folder: Folder of checkpoints, the steps that are learned from, `history.csv` and TensorBoard's events.
        options: Settings of SAC.
        stage: Name of the stage in progress and messages.
        seed: Seed of networks and worlds, 0 or more.
        about: Description of the worlds, as JSON takes it: a checkpoint with another one is refused.
        on_round: Called with a seed before worlds are reset at the beginning of a round, to draw its domains.
        resume: Flag: the training goes on from a checkpoint, where there is one.
        until: What ends it before its last round.
        device: Device of the networks, as torch names it; the policy that is returned is on the CPU.
        report: Called with the progress of the training.

    Returns:
        The best policy, by its evaluations.

    Raises:
        ParameterError: The specification is of another policy.
        InputError: A checkpoint cannot be used, or a file cannot be written.
    """
    if (spec.observes, spec.head) != ("state", "dither"):
        raise ParameterError(f"spec: got {spec.observes} and {spec.head}; allowed: state and dither")
    told = {"options": asdict(options), "seed": seed, "spec": spec.to_document(), "worlds": env.num_envs}
    actions = math.ceil(min(options.round_steps, options.steps) / env.num_envs)  # of each world in a round
    size = env.num_envs * actions
    total = math.ceil(options.steps / size)
    rounds = Rounds(
        folder, stage, {**told, **(about or {})}, seed, resume=resume, total=total, until=until, report=report
    )
    replay, model = prepare_folder(folder / "replay"), _model(AlongHeading(env, spec.task), spec, options, seed, device)
    model.set_logger(configure(str(folder / "tensorboard"), ["tensorboard"]))
    if rounds.number:
        _unpack(rounds.arrays, model)
    if not rounds.ended(options.patience):
        for number in range(rounds.number):
            _refill(model.replay_buffer, _read(replay / f"{number:04}.npz"))
    while not rounds.ended(options.patience):
        rounds.begin(env, on_round)
        model.lr_schedule = ConstantSchedule(options.learning_rate * rounds.falling(options.last_share))
        kept = rounds.restore(env)
        if kept is not None:
            _unpack(kept, model)
            set_generator_state(model.action_space.np_random, kept["random"])
            _refill(model.replay_buffer, {name: kept[f"{_REPLAY}{name}"] for name in _STORED})
        done = begin_round(model, rounds, kept)
        arrays = partial(_kept, model, rounds)
        callback = RoundCallback(rounds, env, size, arrays, loss="train/critic_loss", period=_TOLD)
        model.learn(size - done, callback=callback, reset_num_timesteps=False, log_interval=_NEVER)
        loss = float(model.logger.name_to_value.get("train/critic_loss", math.nan))
        write_arrays(replay / f"{rounds.number:04}.npz", {}, _last(model.replay_buffer, actions))
        actor = _actor(model, spec)
        found = evaluate_worlds(env, Policy(spec, actor), options.episodes, seed=EVALUATION_SEED)
        rounds.end(_pack(model), actor, found, steps=size, loss=loss, logger=model.logger)
    return Policy(spec, rounds.best_actor(spec))


def _model(env: VecEnv, spec: PolicySpec, options: SacOptions, seed: int, device: str) -> SAC:
    return SAC(
        "MlpPolicy",
        env,
        learning_rate=options.learning_rate,
        buffer_size=options.buffer_size,
        learning_starts=min(options.learning_starts, options.steps // 4),
        batch_size=options.batch_size,
        tau=options.tau,
        gamma=options.gamma,
        n_steps=options.n_steps,
        train_freq=1,
        gradient_steps=max(1, env.num_envs // options.update_every),
        ent_coef=f"auto_{options.entropy}",
        policy_kwargs={
            "net_arch": [spec.width, spec.width],
            "features_extractor_class": HeadingExtractor,
            "features_extractor_kwargs": {"task": spec.task},
        },
        seed=seed,
        device=device,
    )


def _actor(model: SAC, spec: PolicySpec) -> DitherActor:
    """The distribution of actions that SAC has learned, as a network of a policy."""
    actor: Any = make_actor(spec)
    set_weights(actor.body, weights(model.actor.latent_pi))
    assert isinstance(model.actor.log_std, nn.Module)
    mean, spread = weights(model.actor.mu), weights(model.actor.log_std)
    set_weights(
        actor.head, {name: np.stack([mean[name], spread[name]], 1).reshape(-1, *mean[name].shape[1:]) for name in mean}
    )
    made: DitherActor = actor.eval()
    return made


def _parts(model: SAC) -> dict[str, tuple[nn.Module, torch.optim.Optimizer | None]]:
    """Everything that is learned, with its optimizers, by name."""
    entropy = nn.Module()
    entropy.register_buffer("log", model.log_ent_coef)
    return {
        "actor": (model.actor, model.actor.optimizer),
        "critic": (model.critic, model.critic.optimizer),
        "target": (model.critic_target, None),
        "entropy": (entropy, model.ent_coef_optimizer),
    }


def _pack(model: SAC) -> Arrays:
    """All that is learned, as arrays whose names begin with those of its parts."""
    arrays = {}
    for part, (network, optimizer) in _parts(model).items():
        found = weights(network) if optimizer is None else pack(network, optimizer)
        arrays.update({f"{part}/{name}": values for name, values in found.items()})
    return arrays


def _unpack(arrays: Mapping[str, np.ndarray], model: SAC) -> None:
    """Restores the arrays of `_pack`."""
    for part, (network, optimizer) in _parts(model).items():
        start = f"{part}/"
        own = {name.removeprefix(start): values for name, values in arrays.items() if name.startswith(start)}
        if optimizer is None:
            set_weights(network, own)
        else:
            unpack(own, network, optimizer)


def _kept(model: SAC, rounds: Rounds) -> Arrays:
    """All that a round needs to go on, but for worlds: what is learned, its steps, and the draw of random actions."""
    steps = (model.num_timesteps - rounds.steps) // model.n_envs
    stored = {f"{_REPLAY}{name}": values for name, values in _last(model.replay_buffer, steps).items()}
    return _pack(model) | stored | {"random": generator_state(model.action_space.np_random)}


def _last(buffer: ReplayBuffer | None, number: int) -> Arrays:
    """The last steps (number, W, ...) of every world, the oldest first, or as many as there are."""
    assert buffer is not None
    number = min(number, buffer.buffer_size if buffer.full else buffer.pos)
    rows = np.arange(buffer.pos - number, buffer.pos) % buffer.buffer_size
    return {name: getattr(buffer, name)[rows] for name in _STORED}


def _refill(buffer: ReplayBuffer | None, arrays: Mapping[str, np.ndarray]) -> None:
    """Adds steps of every world, as `_last` gave them."""
    assert buffer is not None
    number = len(arrays["rewards"])
    rows = np.arange(buffer.pos, buffer.pos + number) % buffer.buffer_size
    for name in _STORED:
        getattr(buffer, name)[rows] = arrays[name]
    buffer.full = buffer.full or buffer.pos + number >= buffer.buffer_size
    buffer.pos = (buffer.pos + number) % buffer.buffer_size


def _read(path: Path) -> Arrays:
    arrays = read_arrays(path, {}, "sac", _STORED)
    if arrays is None:
        raise InputError(path, value="no such file", allowed="the steps beside a checkpoint; start anew")
    return arrays
