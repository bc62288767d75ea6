# SPDX-License-Identifier: MIT
"""Distillation of a policy of the state into one of images, by DAgger.

The student acts; the teacher, who sees the state, gives the probabilities of its own actions; the student learns these
from all images so far. In a given state the student acts as the teacher does, with the same weights; it learns to see
the state.

Source: Ross, Gordon and Bagnell, "A reduction of imitation learning and structured prediction to no-regret online
learning" (AISTATS 2011); the teacher's privilege as in Chen et al., "Learning by cheating" (CoRL 2019).
"""

import math
from collections.abc import Iterator
from dataclasses import dataclass
from typing import Any, ClassVar

import numpy as np
import torch
from stable_baselines3.common.vec_env import VecEnv

from pinwm_drake.checkpoints import generator_state, set_generator_state
from pinwm_drake.files import prepare_folder
from pinwm_drake.learning.actors import ImageActor
from pinwm_drake.learning.images.augment import Augment
from pinwm_drake.learning.images.estimated import estimation_loss, shown_components, usual_errors
from pinwm_drake.learning.images.image_buffer import Chunk, Frames
from pinwm_drake.learning.options import Options
from pinwm_drake.learning.policy import Policy, make_actor
from pinwm_drake.learning.rounds import EVALUATION_SEED, Round, Rounds, StageRun
from pinwm_drake.learning.spec import PolicySpec
from pinwm_drake.learning.weights import device_of, has_bfloat16, pack, set_weights, unpack, weights
from pinwm_drake.learning.world_evaluation import evaluate_worlds, usual_starts

STAGE = "distil"
_COLLECTING = 0.4  # share of a round's time, roughly; the rest goes into updates
_TOLD = 10  # actions or updates between two reports


@dataclass(frozen=True)
class DistilOptions(Options):
    """Settings of the distillation.

    Attributes:
        rounds: Number of rounds; each collects images, learns, and is evaluated.
        round_images: Number of images of all worlds in a round; rounded up to whole actions.
        updates: Number of updates of the network in a round.
        batch_size: Number of images in an update.
        learning_rate: Learning rate of Adam at first; it falls to a hundredth along half a cosine.
        action_weight: Weight of `StateActor.imitation` beside the state's error, in tasks that do not tell errors;
            in the others it spoils the estimate.
        noise: Standard deviation of the normal noise on the actions while images are collected, in units of an action.
        keep: Number of images that are kept; older ones are forgotten.
        shift: px, largest random shift of the images.
        gain: Relative half-width of the colours' random factors.
        mask: px, by which masks are too small or too large at the most, up to 1; see `Augment`.
        episodes: Number of episodes in an evaluation.
    """

    may_be_zero: ClassVar[tuple[str, ...]] = ("action_weight", "noise", "shift", "gain", "mask")
    up_to_one: ClassVar[tuple[str, ...]] = ("mask",)

    rounds: int = 5
    round_images: int = 24_576
    updates: int = 600
    batch_size: int = 256
    learning_rate: float = 1e-3
    action_weight: float = 0.1
    noise: float = 0.1
    keep: int = 300_000
    shift: int = 0
    gain: float = 0.2
    mask: float = 0.0
    episodes: int = 64

    @classmethod
    def within_minutes(cls) -> "DistilOptions":
        """Return settings for a budget of minutes: rounds of a third as many images, so that some of them fit.

        The student acts from the second round on. A student of one round has seen nothing but where its teacher went.
        """
        return cls(rounds=10, round_images=8192, updates=300)


def train_distil(env: VecEnv, teacher: Policy, spec: PolicySpec, options: DistilOptions, run: StageRun) -> Policy:
    """Trains a policy of images.

    Args:
        env: Worlds with observation "rgb_state".
        teacher: A policy of the state.
        spec: Specification of the student.
        options: Settings of the distillation.
        run: The run, whose folder also has the images, and whose description names the teacher.

    Returns:
        The student of the last round, which has learned most; the best one by its evaluation, where the last one is
        worse by more than chance.

    Raises:
        InputError: A checkpoint cannot be used, or a file cannot be written.
    """
    rounds = Rounds(run.telling(options, spec, env), options.rounds)
    student, optimizer = _begin(spec, teacher, options, run.device)
    frames, images = Frames(env.num_envs, spec.frames, options.keep), prepare_folder(rounds.folder / "images")
    if rounds.number:
        unpack(rounds.arrays, student, optimizer)
    for number in range(rounds.number):
        frames.add(Chunk.read(images / f"{number:04}.npz"))
    augment = Augment(options.shift, options.gain, options.mask)
    while not rounds.ended(options.rounds):
        rounds.begin(env)
        generator = np.random.default_rng(np.random.randint(1 << 31))  # noqa: NPY002  # seeded by `begin`
        if rounds.number == 0:
            student, optimizer = _begin(spec, teacher, options, run.device)
        path, losses = images / f"{rounds.number:04}.npz", []
        kept = rounds.restore(env)
        if kept is None:
            # In the first round the teacher acts: an untrained student would see little that matters.
            actor = teacher if rounds.number == 0 else Policy(spec, student)
            with usual_starts(env):
                chunk = _collect(env, actor, student, options, generator, rounds)
            chunk.write(path)
        else:
            chunk = Chunk.read(path)
            unpack(kept, student, optimizer)
            set_generator_state(generator, kept["generator"])
            losses = kept["losses"].tolist()
        frames.add(chunk)
        for _ in _learn(student, optimizer, frames, augment, options, rounds, generator, losses):
            if rounds.due(env):
                state = {"generator": generator_state(generator), "losses": np.array(losses)}
                rounds.keep(env, pack(student, optimizer) | state)
            if len(losses) % _TOLD == 0:
                share = _COLLECTING + (1.0 - _COLLECTING) * len(losses) / options.updates
                rounds.tell(share, steps=len(chunk.start), loss=losses[-1])
        # The mean loss of the last tenth of the updates.
        loss = float(np.mean(losses[-max(1, len(losses) // 10) :]))
        found = evaluate_worlds(env, Policy(spec, student), options.episodes, seed=EVALUATION_SEED)
        rounds.end(pack(student, optimizer), student, found, steps=len(chunk.start), loss=loss)
    if is_worse(rounds.history[-1], rounds.best, options.episodes):
        return Policy(spec, rounds.best_actor(spec))
    last = make_actor(spec)
    set_weights(last, weights(student))
    return Policy(spec, last.eval())


def is_worse(last: Round, best: Round | None, episodes: int) -> bool:
    """Flag: a round is worse than the best by more than chance: two standard errors of the difference in success."""
    if best is None:
        return False
    share = 0.5 * (last.success + best.success)
    return last.success < best.success - 2.0 * math.sqrt(2.0 * share * (1.0 - share) / episodes)


def _begin(
    spec: PolicySpec, teacher: Policy, options: DistilOptions, device: str
) -> tuple[ImageActor, torch.optim.Optimizer]:
    """Return a student that acts as the teacher before it sees, and its optimizer; both follow from the seed."""
    student = make_actor(spec).to(device)
    assert isinstance(student, ImageActor)
    student.mixed_precision = has_bfloat16(device)
    set_weights(student.actor, weights(teacher.actor))
    student.actor.requires_grad_(False)
    learned = [one for one in student.parameters() if one.requires_grad]
    return student, torch.optim.Adam(learned, options.learning_rate)


def _collect(
    env: VecEnv,
    actor: Policy,
    student: ImageActor,
    options: DistilOptions,
    generator: np.random.Generator,
    rounds: Rounds,
) -> Chunk:
    """Images, or their parts that a student sees, and states of worlds in which a policy acts, with noise."""
    W = env.num_envs
    length = math.ceil(options.round_images / W)
    seen: Any = env.reset()
    image, _ = student.parts(seen["image"][..., -3:])
    rows = W * length
    chunk = Chunk(
        np.empty((rows, *image.shape[1:]), np.uint8),
        np.empty(rows, bool),
        np.empty((rows, *seen["pusher"].shape[1:]), np.float32),
        np.empty((rows, *seen["state"].shape[1:]), np.float32),
        np.zeros((rows, actor.spec.task.goal_size), np.float32),
        np.empty((rows, 2), np.int16),
    )
    starts = np.ones(W, bool)
    for t in range(length):
        at = slice(t * W, (t + 1) * W)
        chunk.image[at], chunk.corner[at] = student.parts(seen["image"][..., -3:])
        chunk.start[at], chunk.pusher[at], chunk.state[at] = starts, seen["pusher"], seen["state"]
        chunk.goal[at] = seen.get("goal", chunk.goal[at])
        actions = actor.predict(seen)[0]
        noise = options.noise * generator.standard_normal(actions.shape)
        seen, _, starts, _ = env.step(np.clip(actions + noise, -1.0, 1.0).astype(np.float32))
        if (t + 1) % _TOLD == 0:
            rounds.tell(_COLLECTING * (t + 1) / length, steps=(t + 1) * W)
    return chunk


def _learn(
    student: ImageActor,
    optimizer: torch.optim.Optimizer,
    frames: Frames,
    augment: Augment,
    options: DistilOptions,
    rounds: Rounds,
    generator: np.random.Generator,
    losses: list[float],
) -> Iterator[None]:
    """Update of a round, from the one after those whose losses are in `losses`; yield after each."""
    total, device = options.rounds * options.updates, device_of(student)
    errors = usual_errors(student.task, student.history, device)
    for update in range(len(losses), options.updates):
        # Of a budget of minutes that ends before the last round as well.
        share = (rounds.number * options.updates + update) / total
        share = max(share, min(rounds.spent(update / options.updates), 1.0))
        rate = options.learning_rate * (0.01 + 0.99 * 0.5 * (1.0 + math.cos(math.pi * share)))
        for group in optimizer.param_groups:
            group["lr"] = rate
        drawn = [torch.from_numpy(one) for one in frames.draw(options.batch_size, generator)]
        # Images that are seen one by one, each with its own state.
        shown = shown_components(drawn[0], student.task, student.history).to(device) if student.history else None
        tint = None
        if augment.changes_colours_alone and student.sees_parts:
            tint = augment.factors(len(drawn[0])).to(device)
        else:
            drawn[0] = augment.as_images(drawn[0])
        images, pusher, state, goal, corner = (one.to(device) for one in drawn)
        drawn_goal, parts = goal if goal.shape[1] else None, corner if student.sees_parts else None
        found = student.state(images, pusher, drawn_goal, parts, tint)
        loss = estimation_loss(found, state, errors, shown)
        if errors is None:
            loss = loss + options.action_weight * student.actor.imitation(found, state)
        optimizer.zero_grad()
        loss.backward()
        optimizer.step()
        losses.append(float(loss.detach()))
        yield
