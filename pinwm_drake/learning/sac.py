# SPDX-License-Identifier: MIT
"""SAC of SB3 on a task's state, in rounds."""

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any, ClassVar

import numpy as np
import torch
from stable_baselines3 import SAC
from stable_baselines3.common.buffers import ReplayBuffer
from stable_baselines3.common.vec_env import VecEnv
from torch import nn

from pinwm_drake.checkpoints import generator_state, read_arrays, set_generator_state, write_arrays
from pinwm_drake.errors import InputError, ParameterError
from pinwm_drake.files import prepare_folder
from pinwm_drake.learning.heading import AlongHeading, HeadingExtractor
from pinwm_drake.learning.options import RewardOptions
from pinwm_drake.learning.policy import Policy, make_actor
from pinwm_drake.learning.round_callback import Arrays, Learner
from pinwm_drake.learning.rounds import Rounds, StageRun
from pinwm_drake.learning.spec import PolicySpec
from pinwm_drake.learning.weights import pack, set_weights, unpack, weights

_TOLD = 20  # actions of each world between two reports
_STORED = ("observations", "next_observations", "actions", "rewards", "dones", "timeouts")
_REPLAY = "replay."


@dataclass(frozen=True)
class SacOptions(RewardOptions):
    """Settings of SAC, as SB3 names them; the learning rate is that of actor, critics and entropy.

    Attributes:
        learning_starts: Number of steps of all worlds with random actions, before anything is learned; at most a
            quarter of all.
        update_every: Number of steps, all worlds together, for each update.
        buffer_size: Number of steps that are kept to learn from; older ones are forgotten.
        n_steps: Number of actions whose rewards are added up before the critics' value of the state after them.
        tau: Share of the critics that their slow copies take over in an update.
        entropy: Weight of the entropy at first; it is learned.
    """

    may_be_zero: ClassVar[tuple[str, ...]] = ("learning_starts",)

    learning_starts: int = 3_200
    update_every: int = 16
    buffer_size: int = 1_000_000
    n_steps: int = 3
    tau: float = 0.01
    entropy: float = 0.1


def train_sac(env: VecEnv, spec: PolicySpec, options: SacOptions, run: StageRun) -> Policy:
    """Trains a policy of the state; the best by its evaluations is kept in the checkpoint.

    Source: Haarnoja et al., "Soft actor-critic: off-policy maximum entropy deep reinforcement learning with a
    stochastic actor" (ICML 2018).

    Args:
        env: Worlds with observation "state".
        spec: Specification of the policy, whose head is "dither".
        options: Settings of SAC.
        run: The run, whose folder also has the steps that are learned from.

    Returns:
        The best policy, by its evaluations.

    Raises:
        ParameterError: The specification is of another policy.
        InputError: A checkpoint cannot be used, or a file cannot be written.
    """
    if (spec.observes, spec.head) != ("state", "dither"):
        raise ParameterError(f"spec: got {spec.observes} and {spec.head}; allowed: state and dither")
    return _Learner(env, spec, options, run).train(env, env, env.num_envs, run)


class _Learner(Learner):
    """SB3's SAC, whose steps are kept in a folder."""

    loss = "train/critic_loss"
    model: SAC

    def __init__(self, env: VecEnv, spec: PolicySpec, options: SacOptions, run: StageRun) -> None:
        self.spec, self.options, self.period = spec, options, _TOLD
        self._folder = prepare_folder(run.folder / "replay")
        self.model = SAC(
            "MlpPolicy",
            AlongHeading(env, spec.task),
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
            seed=run.seed,
            device=run.device,
        )

    def network(self) -> nn.Module:
        actor: Any = make_actor(self.spec)
        learned: Any = self.model.actor
        set_weights(actor.body, weights(learned.latent_pi))
        mean, spread = weights(learned.mu), weights(learned.log_std)
        both = {name: np.stack([mean[name], spread[name]], 1).reshape(-1, *mean[name].shape[1:]) for name in mean}
        set_weights(actor.head, both)
        made: nn.Module = actor.eval()
        return made

    def _parts(self) -> dict[str, tuple[nn.Module, torch.optim.Optimizer | None]]:
        model, entropy = self.model, nn.Module()
        entropy.register_buffer("log", model.log_ent_coef)
        return {
            "actor": (model.actor, model.actor.optimizer),
            "critic": (model.critic, model.critic.optimizer),
            "target": (model.critic_target, None),
            "entropy": (entropy, model.ent_coef_optimizer),
        }

    def pack(self) -> Arrays:
        arrays = {}
        for part, (network, optimizer) in self._parts().items():
            found = weights(network) if optimizer is None else pack(network, optimizer)
            arrays.update({f"{part}/{name}": values for name, values in found.items()})
        return arrays

    def unpack(self, arrays: Mapping[str, np.ndarray]) -> None:
        for part, (network, optimizer) in self._parts().items():
            start = f"{part}/"
            own = {name.removeprefix(start): values for name, values in arrays.items() if name.startswith(start)}
            if optimizer is None:
                set_weights(network, own)
            else:
                unpack(own, network, optimizer)
        if "random" in arrays:  # those of a round that goes on
            set_generator_state(self.model.action_space.np_random, arrays["random"])
            _refill(self.model.replay_buffer, {name: arrays[f"{_REPLAY}{name}"] for name in _STORED})

    def kept(self, done: int) -> Arrays:
        steps = _last(self.model.replay_buffer, done // self.model.n_envs)
        stored = {f"{_REPLAY}{name}": values for name, values in steps.items()}
        return self.pack() | stored | {"random": generator_state(self.model.action_space.np_random)}

    def prepare(self, rounds: Rounds) -> None:
        for number in range(rounds.number):
            _refill(self.model.replay_buffer, _read(self._path(number)))

    def ended(self, rounds: Rounds, size: int) -> None:
        write_arrays(self._path(rounds.number), {}, _last(self.model.replay_buffer, size // self.model.n_envs))

    def _path(self, number: int) -> Path:
        return self._folder / f"{number:04}.npz"


def _last(buffer: ReplayBuffer | None, number: int) -> Arrays:
    """Return the last steps (number, W, ...) of every world, the oldest first, or as many as there are."""
    assert buffer is not None
    number = min(number, buffer.buffer_size if buffer.full else buffer.pos)
    rows = np.arange(buffer.pos - number, buffer.pos) % buffer.buffer_size
    return {name: getattr(buffer, name)[rows] for name in _STORED}


def _refill(buffer: ReplayBuffer | None, arrays: Mapping[str, np.ndarray]) -> None:
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
