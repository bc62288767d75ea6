# SPDX-License-Identifier: MIT
"""Dreamer V2 as a method: task-agnostic episodes, a world model of them, and a policy of its imagination."""

import shutil
from collections.abc import Sequence
from dataclasses import asdict, dataclass, field, fields, replace
from pathlib import Path

from pinwm_drake.checkpoints import digest_of
from pinwm_drake.errors import InputError, require
from pinwm_drake.learning.method import MakeWorlds, MethodData
from pinwm_drake.learning.progress import Report
from pinwm_drake.learning.rounds import ANY, StageRun, Until
from pinwm_drake.learning.spec import PolicySpec
from pinwm_drake.learning.weights import require_device
from pinwm_drake.paper.baselines.dreamer.episodes import Replay, collect, random_pushes
from pinwm_drake.paper.baselines.dreamer.options import BehaviourOptions, ModelOptions, NetworkOptions
from pinwm_drake.paper.baselines.dreamer.policy import DreamerPolicy, image_size, write_dreamer
from pinwm_drake.paper.baselines.dreamer.training import BEHAVIOUR, MODEL, train_behaviour, train_model
from pinwm_drake.paper.baselines.dreamer.world_model import halvings
from pinwm_drake.paper.baselines.recording import Episode, read_episodes

EPISODES = "episodes"  # folder of what was collected
_MODEL_SHARE = 0.5  # of the minutes, at most


@dataclass(frozen=True)
class DreamerV2:
    """Dreamer V2, which learns from recorded episodes alone.

    The best of some rounds of the behaviour's training is found by episodes in the worlds, as with other methods.

    Source: Hafner et al., "Mastering Atari with discrete world models" (ICLR 2021); 100 task-agnostic episodes as in Li
    et al., "PIN-WM" (RSS 2025).

    Attributes:
        episodes: Number of episodes that are collected where there are none in the data.
        until: What ends the training before its last round; of the minutes, the world model takes half at most.
        device: Device of the networks, as torch names it; the policy that is returned is on the CPU.

    Raises:
        ParameterError: The number of episodes is out of range, or there is no such device.
    """

    episodes: int = 100
    networks: NetworkOptions = field(default_factory=NetworkOptions)
    model: ModelOptions = field(default_factory=ModelOptions)
    behaviour: BehaviourOptions = field(default_factory=BehaviourOptions)
    until: Until = ANY
    device: str = "cpu"

    def __post_init__(self) -> None:
        require("episodes", self.episodes, self.episodes >= 1, "1 or more")
        require_device("device", self.device)

    def train(
        self, data: MethodData, make_worlds: MakeWorlds, out: Path, *, seed: int, resume: bool, report: Report
    ) -> DreamerPolicy:
        """Trains in folders of `out`, one for each stage, and writes the policy to `out`; see `Method.train`."""
        spec, env = make_worlds.spec("rgb"), make_worlds.worlds("rgb_state")
        halvings(image_size(spec))
        from_worlds = {"worlds": make_worlds.about, "num_worlds": env.num_envs, "episodes": self.episodes, "seed": seed}
        told: dict[str, object] = {**from_worlds, "spec": spec.to_document(), "networks": asdict(self.networks)}
        if data.trajectories is None:
            if not resume:
                shutil.rmtree(out / EPISODES, ignore_errors=True)
            explore, begin = random_pushes(spec, env.num_envs), make_worlds.begin
            about = from_worlds
            episodes = collect(env, explore, out / EPISODES, self.episodes, seed=seed, about=about, on_batch=begin)
        else:
            episodes = read_episodes(data.trajectories)
            if not episodes:
                raise InputError(data.trajectories, value="no episode", allowed="files 00000.npz and so on")
            _check(data.trajectories, episodes, spec)
            told["trajectories"] = digest_of(getattr(one, part.name) for one in episodes for part in fields(Episode))
        replay = Replay(episodes)
        for stage, options in ((MODEL, self.model), (BEHAVIOUR, self.behaviour)):
            most = len(replay)
            require(f"{stage}.length", options.length, options.length <= most, f"up to {most}, all recorded steps")
        told["model"] = asdict(self.model)
        half = replace(self.until, minutes=_MODEL_SHARE * self.until.minutes)
        run = StageRun(out / MODEL, MODEL, seed, told, make_worlds.begin, resume, half, self.device, report)
        model, updates, seconds = train_model(replay, self.networks, self.model, run)
        run = replace(
            run,
            folder=out / BEHAVIOUR,
            stage=BEHAVIOUR,
            about={**told, "updates": updates, "behaviour": asdict(self.behaviour)},
            until=self.until.within(self.until.minutes - seconds / 60.0),
        )
        policy = train_behaviour(env, model, replay, spec, self.networks, self.behaviour, run)
        write_dreamer(out, policy)
        return policy


def _check(folder: Path, episodes: Sequence[Episode], spec: PolicySpec) -> None:
    wanted = (image_size(spec), image_size(spec), spec.action_size)
    for number, one in enumerate(episodes):
        given = (*one.images.shape[1:3], one.actions.shape[1])
        if given != wanted:
            words = "height and width of images, and components of actions, of"
            raise InputError(folder, row=number + 1, value=f"{words} {given}", allowed=f"{wanted}, as of the worlds")
