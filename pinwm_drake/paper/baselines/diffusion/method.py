# SPDX-License-Identifier: MIT
"""The training of diffusion policy from demonstrations.

Source: Chi et al., "Diffusion policy: visuomotor policy learning via action diffusion" (RSS 2023), the variant with
convolutions. It takes positions as actions; here an action is what the worlds take, a translation.
"""

import math
from collections.abc import Iterator
from dataclasses import asdict, dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
import torch
from pydantic_core import to_jsonable_python
from torch import Tensor
from torch.optim.swa_utils import AveragedModel

from pinwm_drake.checkpoints import generator_state, set_generator_state
from pinwm_drake.errors import InputError, ParameterError
from pinwm_drake.learning.images.augment import Augment
from pinwm_drake.learning.method import MakeWorlds, MethodData
from pinwm_drake.learning.progress import Report
from pinwm_drake.learning.rounds import ANY, EVALUATION_SEED, Rounds, StageRun, Until
from pinwm_drake.learning.weights import pack, require_device, set_weights, unpack, weights
from pinwm_drake.learning.world_evaluation import evaluate_worlds
from pinwm_drake.paper.baselines.diffusion.actor import DiffusionActor, write_actor
from pinwm_drake.paper.baselines.diffusion.demonstrations import Episode, Windows, digest, read_demonstrations
from pinwm_drake.paper.baselines.diffusion.network import DiffusionNetwork
from pinwm_drake.paper.baselines.diffusion.options import NetworkOptions, TrainingOptions

STAGE = "diffusion"  # the folder of the stage too
_TOLD = 20  # updates between two reports
_AVERAGE = "ema."
_Weights = tuple[Tensor, ...] | list[Tensor]


@dataclass(frozen=True)
class DiffusionPolicy:
    """Diffusion policy of recorded demonstrations, which needs the extra `paper` of the package.

    Attributes:
        device: Device of the network, as torch names it; the policy that is returned is on the CPU.
    """

    network: NetworkOptions = field(default_factory=NetworkOptions)
    training: TrainingOptions = field(default_factory=TrainingOptions)
    until: Until = ANY
    device: str = "cpu"

    def __post_init__(self) -> None:
        require_device("device", self.device)

    def train(
        self, data: MethodData, make_worlds: MakeWorlds, out: Path, *, seed: int, resume: bool, report: Report
    ) -> DiffusionActor:
        """Trains the policy in `out/diffusion`, and writes the best one to `policy` in there; see `Method.train`.

        The worlds serve evaluations alone. In progress and in `history.csv`, the steps are updates of the network.
        """
        if data.demonstrations is None:
            raise ParameterError("demonstrations: got none; allowed: a folder of recorded episodes")
        env, spec, folder = make_worlds.worlds("rgb_state"), make_worlds.spec("rgb"), out / STAGE
        best = DiffusionActor(spec, DiffusionNetwork(self.network, spec.action_size).eval(), seed)
        episodes, options = read_demonstrations(data.demonstrations), self.training
        _check(data.demonstrations, episodes[0], env.observation_space, spec.action_size)
        network = to_jsonable_python(asdict(self.network))
        about = {"network": network, "demonstrations": digest(episodes), **make_worlds.about}
        total = math.ceil(options.updates / options.round_updates)
        run = StageRun(folder, STAGE, seed, about, make_worlds.begin, resume, self.until, self.device, report)
        rounds = Rounds(run.telling(options, spec, env), total)
        windows = Windows(episodes, self.network.observations, self.network.horizon)
        learner = _Learner(self, windows, spec.action_size)
        if rounds.number:
            learner.restore(rounds.arrays)
        while not rounds.ended(total):
            rounds.begin(env)
            generator, losses = np.random.default_rng(np.random.randint(1 << 31)), []  # noqa: NPY002  # seeded by `begin`
            if rounds.number == 0:
                learner = _Learner(self, windows, spec.action_size)
            kept = rounds.restore(env)
            if kept is not None:
                learner.restore(kept)
                set_generator_state(generator, kept["generator"])
                losses = kept["losses"].tolist()
            for _ in learner.learn(rounds.number, generator, losses):
                if rounds.due(env):
                    state = {"generator": generator_state(generator), "losses": np.array(losses)}
                    rounds.keep(env, learner.arrays() | state)
                if len(losses) % _TOLD == 0:
                    rounds.tell(len(losses) / options.round_updates, steps=len(losses), loss=losses[-1])
            actor = DiffusionActor(spec, learner.averaged, seed)
            found = evaluate_worlds(env, actor, options.episodes, seed=EVALUATION_SEED)
            loss = float(np.mean(losses[-max(1, len(losses) // 10) :]))
            rounds.end(learner.arrays(), learner.averaged, found, steps=options.round_updates, loss=loss)
        set_weights(best.network, rounds.best_weights())
        write_actor(folder / "policy", best)
        return best


class _Learner:
    """Network, optimizer and moving average, and their updates; the network's first weights follow from the seed."""

    def __init__(self, method: DiffusionPolicy, windows: Windows, action_size: int) -> None:
        self._options, self._windows, self._device = method.training, windows, method.device
        self._network = DiffusionNetwork(method.network, action_size)
        self._network.action.fit(torch.from_numpy(windows.action))
        self._network.pusher.fit(torch.from_numpy(windows.pusher))
        self._network.to(method.device)
        self._optimizer = torch.optim.AdamW(
            self._network.parameters(),
            self._options.learning_rate,
            betas=(0.95, 0.999),
            weight_decay=self._options.weight_decay,
        )
        self._average = AveragedModel(self._network, multi_avg_fn=self._add_to_average)
        self._augment = Augment(self._options.shift, self._options.gain)

    @property
    def averaged(self) -> DiffusionNetwork:
        network = self._average.module
        assert isinstance(network, DiffusionNetwork)
        return network.eval()

    def arrays(self) -> dict[str, np.ndarray]:
        average = {f"{_AVERAGE}{name}": value for name, value in weights(self._average).items()}
        return pack(self._network, self._optimizer) | average

    def restore(self, arrays: dict[str, np.ndarray]) -> None:
        unpack(arrays, self._network, self._optimizer)
        average = {name: values for name, values in arrays.items() if name.startswith(_AVERAGE)}
        set_weights(self._average, {name.removeprefix(_AVERAGE): values for name, values in average.items()})

    def learn(self, number: int, generator: np.random.Generator, losses: list[float]) -> Iterator[None]:
        """Update of a round, from the one after those whose losses are in `losses`; yield after each."""
        options = self._options
        total = options.round_updates * math.ceil(options.updates / options.round_updates)
        self._network.train()
        for update in range(len(losses), options.round_updates):
            rate = _learning_rate(options, number * options.round_updates + update, total)
            for group in self._optimizer.param_groups:
                group["lr"] = rate
            drawn = self._windows.draw(options.batch_size, generator)
            image, pusher, action = (torch.from_numpy(one).to(self._device) for one in drawn)
            loss = self._network.loss(self._augment(image), pusher, action)
            self._optimizer.zero_grad()
            loss.backward()
            self._optimizer.step()
            self._average.update_parameters(self._network)
            losses.append(float(loss.detach()))
            yield

    def _add_to_average(self, averages: _Weights, now: _Weights, updates: Tensor | int) -> None:
        """Move the moving averages of weights, in place, to those with the values after one more update."""
        decay = min(1.0 - (1.0 + float(updates)) ** -self._options.average_power, self._options.average_most)
        torch._foreach_lerp_(averages, now, 1.0 - decay)


def _learning_rate(options: TrainingOptions, update: int, total: int) -> float:
    """Learning rate of an update, counted from 0: even warm-up, then half a cosine."""
    if update < options.warmup:
        return options.learning_rate * (update + 1) / options.warmup
    share = (update - options.warmup) / max(total - options.warmup, 1)
    return options.learning_rate * 0.5 * (1.0 + math.cos(math.pi * share))


def _check(folder: Path, episode: Episode, space: Any, action_size: int) -> None:
    """Check that an episode was recorded in such worlds; raise InputError."""
    given, wanted = (*episode.image.shape[1:3], episode.action.shape[1]), (*space["image"].shape[:2], action_size)
    if given != wanted:
        words = "episodes with height and width of images, and components of actions,"
        raise InputError(folder, value=f"{words} of {given}", allowed=f"{wanted}, as the worlds have them")
