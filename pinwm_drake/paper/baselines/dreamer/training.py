# SPDX-License-Identifier: MIT
"""Training of the world model on recorded episodes, and then of actor and critic in its imagination.

The paper's code does both in turn, as its data grow. Here all data are there from the beginning, so that the model is
learned first, and stays as it is while the policy is. Every update begins from a seed of its own, so that a training
that was killed goes on with the same result.
"""

import csv
import math
import time
from dataclasses import fields
from pathlib import Path

import numpy as np
import torch
from stable_baselines3.common.vec_env import VecEnv
from torch import nn

from pinwm_drake.checkpoints import read_arrays, write_arrays
from pinwm_drake.errors import InputError, ParameterError
from pinwm_drake.files import prepare_folder, replacing
from pinwm_drake.learning.progress import Step
from pinwm_drake.learning.rounds import CHECKPOINT_FILE, EVALUATION_SEED, Rounds, StageRun
from pinwm_drake.learning.spec import PolicySpec
from pinwm_drake.learning.weights import device_of, pack, set_weights, unpack
from pinwm_drake.learning.world_evaluation import evaluate_worlds
from pinwm_drake.pace import Pace
from pinwm_drake.paper.baselines.dreamer.behaviour import Actor, Behaviour
from pinwm_drake.paper.baselines.dreamer.episodes import Replay
from pinwm_drake.paper.baselines.dreamer.options import BehaviourOptions, ModelOptions, NetworkOptions
from pinwm_drake.paper.baselines.dreamer.policy import DreamerPolicy, image_size
from pinwm_drake.paper.baselines.dreamer.world_model import Terms, WorldModel

MODEL, BEHAVIOUR = "model", "behaviour"  # stages, and their folders
CURVE_FILE = "curve.csv"
_TERMS = tuple(one.name for one in fields(Terms))
_TOLD = 20  # updates between two reports, and between two rows of the curve
_PERIOD = 30.0  # s, between two checkpoints


def train_model(
    replay: Replay, networks: NetworkOptions, options: ModelOptions, run: StageRun
) -> tuple[WorldModel, int, float]:
    """Trains a world model.

    Args:
        run: The run, whose folder has the checkpoint and `curve.csv`: terms of the loss, means of 20 updates. It ends
            after its minutes.

    Returns:
        The model on the run's device, without gradients; the number of updates it had; and their seconds, all runs
        together.

    Raises:
        InputError: The checkpoint cannot be used, or a file cannot be written.
        ParameterError: The images have no size that the networks take.
    """
    path = prepare_folder(run.folder) / CHECKPOINT_FILE
    generator_of(run.seed, MODEL, -1)
    model = WorldModel(replay.image_size, replay.action_size, networks).to(run.device)
    optimizer = _adam([(model, options.learning_rate)], options.weight_decay)
    stored = read_arrays(path, run.about, MODEL, ["curve", "seconds"]) if run.resume else None
    curve = np.zeros((0, len(_TERMS)))
    begun, pace = time.monotonic(), Pace()
    if stored is not None:
        curve, begun = stored.pop("curve"), begun - float(stored.pop("seconds"))
        unpack(stored, model, optimizer)
    kept, rows = time.monotonic(), list(curve)

    def keep() -> None:
        arrays = {**pack(model, optimizer), "curve": np.array(rows), "seconds": np.array(time.monotonic() - begun)}
        write_arrays(path, run.about, arrays)
        _write_curve(run.folder / CURVE_FILE, np.array(rows))

    while len(rows) < options.updates and time.monotonic() - begun < 60.0 * run.until.minutes:
        batch = replay.draw(options.batch_size, options.length, generator_of(run.seed, MODEL, len(rows)))
        terms = model.loss(batch.to(run.device), options)
        optimizer.zero_grad()
        terms.total.backward()
        nn.utils.clip_grad_norm_(model.parameters(), options.clip)
        optimizer.step()
        rows.append(np.array([float(getattr(terms, name).detach()) for name in _TERMS]))
        if time.monotonic() - kept > _PERIOD:
            keep()
            kept = time.monotonic()
        if len(rows) % _TOLD == 0:
            done, steps = len(rows) / options.updates, len(rows) * options.batch_size * options.length
            rate, left = pace(done, steps)
            loss, seconds = float(terms.total.detach()), time.monotonic() - begun
            run.report(Step(MODEL, done, steps, math.nan, math.nan, loss, math.nan, seconds, rate=rate, left=left))
    if stored is None or len(rows) > len(curve):
        keep()
    return model.requires_grad_(False).eval(), len(rows), time.monotonic() - begun


def read_world_model(folder: Path, policy: DreamerPolicy) -> WorldModel:
    """Read the world model of a training, which stays in its checkpoint.

    Returns:
        The model, without gradients.

    Raises:
        InputError: There is no checkpoint, or it cannot be read, or is of other sizes.
    """
    path = folder / MODEL / CHECKPOINT_FILE
    arrays = read_arrays(path, {}, MODEL)
    if arrays is None:
        raise InputError(path, value="no such file", allowed="the checkpoint of a world model's training")
    model = WorldModel(image_size(policy.spec), policy.spec.action_size, policy.networks)
    try:
        set_weights(model, {name.removeprefix("net."): a for name, a in arrays.items() if name.startswith("net.")})
    except ParameterError as error:
        raise InputError(path, value=error, allowed="a world model of the policy's sizes") from error
    return model.requires_grad_(False).eval()


def train_behaviour(
    env: VecEnv,
    model: WorldModel,
    replay: Replay,
    spec: PolicySpec,
    networks: NetworkOptions,
    options: BehaviourOptions,
    run: StageRun,
) -> DreamerPolicy:
    """Trains actor and critic in a world model, on its device.

    Args:
        env: Worlds with observation "rgb_state", in which each round is evaluated; nothing is learned from them.
        model: The world model, without gradients; it is on the CPU afterwards.
        replay: Steps of the episodes, whose states the imagination begins from.
        run: The run, on the device of the model; the steps of its `history.csv` are imagined ones.

    Returns:
        The policy, on the CPU, of the best round by its evaluation; of the last one where none had a success.

    Raises:
        InputError: A checkpoint cannot be used, or a file cannot be written.
    """
    rounds = Rounds(run, options.rounds)
    generator_of(run.seed, BEHAVIOUR, -1)
    device = device_of(model)
    behaviour = Behaviour(replay.action_size, networks).to(device)
    rates = [(behaviour.actor, options.actor_rate), (behaviour.critic, options.critic_rate)]
    optimizer = _adam(rates, options.weight_decay)
    if rounds.number:
        unpack(rounds.arrays, behaviour, optimizer)
    policy = DreamerPolicy(spec, networks, model.perception, behaviour.actor)
    imagined = options.batch_size * options.length * options.horizon
    while not rounds.ended(options.rounds):
        rounds.begin(env)
        losses: list[float] = []
        kept = rounds.restore(env)
        if kept is not None:
            losses = kept.pop("losses").tolist()
            unpack(kept, behaviour, optimizer)
        while len(losses) < options.round_updates:
            number = rounds.number * options.round_updates + len(losses)
            generator = generator_of(run.seed, BEHAVIOUR, number)
            if number % options.target_period == 0:
                behaviour.follow()
            batch = replay.draw(options.batch_size, options.length, generator).to(device)
            actor_loss, critic_loss = behaviour.losses(model, batch, options)
            optimizer.zero_grad()
            (actor_loss + critic_loss).backward()
            for network, _ in rates:
                nn.utils.clip_grad_norm_(network.parameters(), options.clip)
            optimizer.step()
            losses.append(float(critic_loss.detach()))
            if rounds.due(env):
                rounds.keep(env, {**pack(behaviour, optimizer), "losses": np.array(losses)})
            if len(losses) % _TOLD == 0:
                rounds.tell(len(losses) / options.round_updates, steps=len(losses) * imagined, loss=losses[-1])
        found = evaluate_worlds(env, policy, options.episodes, seed=EVALUATION_SEED)
        loss = float(np.mean(losses[-_TOLD:]))
        steps = options.round_updates * imagined
        rounds.end(pack(behaviour, optimizer), behaviour.actor, found, steps=steps, loss=loss)
    actor = Actor(replay.action_size, networks)
    set_weights(actor, rounds.best_weights())
    return DreamerPolicy(spec, networks, model.cpu().perception, actor)


def generator_of(seed: int, stage: str, number: int) -> np.random.Generator:
    """Return the generator of an update of a stage, or of its beginning for -1; torch's generator is seeded too."""
    sequence = np.random.SeedSequence(seed, spawn_key=(int.from_bytes(stage.encode()[:4], "little"), number + 1))
    torch.manual_seed(int(sequence.generate_state(1)[0]))
    return np.random.default_rng(sequence)


def _adam(rates: list[tuple[nn.Module, float]], weight_decay: float) -> torch.optim.Optimizer:
    """Optimizer of some networks with a learning rate each, as the paper's code has it."""
    groups = [{"params": list(network.parameters()), "lr": rate} for network, rate in rates]
    return torch.optim.AdamW(groups, eps=1e-5, weight_decay=weight_decay)


def _write_curve(path: Path, rows: np.ndarray) -> None:
    """Write the means of 20 updates each, and the number of updates until then."""
    whole = rows[: len(rows) // _TOLD * _TOLD].reshape(-1, _TOLD, len(_TERMS)).mean(1)
    with replacing(path) as temporary, temporary.open("w", newline="", encoding="utf-8") as file:
        writer = csv.writer(file, lineterminator="\n")
        writer.writerow(["updates", *_TERMS])
        writer.writerows([_TOLD * (k + 1), *(f"{value:.6g}" for value in row)] for k, row in enumerate(whole))
