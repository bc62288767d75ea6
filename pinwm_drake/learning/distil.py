"""Distillation of a policy of the state into one of images, by DAgger.

The student acts, the teacher, who sees the state, says how likely it would have done what, and the student learns that
from all images so far.

Source: Ross, Gordon and Bagnell, "A reduction of imitation learning and structured prediction to no-regret online
learning" (AISTATS 2011); the teacher's privilege as in Chen et al., "Learning by cheating" (CoRL 2019). The student
learns the object's pose on the side.
"""

import math
from collections.abc import Mapping
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

import numpy as np
import torch
from stable_baselines3.common.logger import configure
from stable_baselines3.common.vec_env import VecEnv
from torch.nn.functional import cross_entropy, mse_loss

from pinwm_drake.files import prepare_folder
from pinwm_drake.learning.actors import ACTION_SIZE, LEVELS, POSE_SIZE, ImageActor
from pinwm_drake.learning.augment import Augment
from pinwm_drake.learning.frames import Chunk, Frames
from pinwm_drake.learning.memory import pack, unpack
from pinwm_drake.learning.options import check_options
from pinwm_drake.learning.policy import Policy, make_actor
from pinwm_drake.learning.progress import Report, silent
from pinwm_drake.learning.rounds import EVALUATION_SEED, OnRound, Rounds
from pinwm_drake.learning.spec import PolicySpec
from pinwm_drake.learning.world_evaluation import evaluate_worlds

STAGE = "distil"


@dataclass(frozen=True)
class DistilOptions:
    """Settings of the distillation.

    Attributes:
        rounds: Each collects images, learns, and is evaluated.
        round_images: Of all worlds in a round; rounded up to whole actions.
        updates: Of the network in a round.
        batch_size: Images in an update.
        learning_rate: Of Adam at first; it falls to a hundredth along half a cosine.
        pose_weight: Of the pose's mean squared error beside the actions' cross-entropy.
        noise: Standard deviation of what is added to the student's actions while it collects.
        keep: Images; older ones are forgotten.
        shift: px, by which images are moved at random, at most.
        gain: Relative half-width of the colours' random factors.
        episodes: Of an evaluation.

    Raises:
        ParameterError: A number is out of range.
    """

    rounds: int = 12
    round_images: int = 24_576
    updates: int = 600
    batch_size: int = 256
    learning_rate: float = 1e-3
    pose_weight: float = 1.0
    noise: float = 0.1
    keep: int = 300_000
    shift: int = 0
    gain: float = 0.2
    episodes: int = 64

    def __post_init__(self) -> None:
        """Checks the values."""
        check_options(self, ("pose_weight", "noise", "shift", "gain"))


def train_distil(
    env: VecEnv,
    teacher: Policy,
    spec: PolicySpec,
    folder: Path,
    options: DistilOptions,
    *,
    seed: int = 0,
    about: Mapping[str, object] | None = None,
    on_round: OnRound | None = None,
    resume: bool = False,
    report: Report = silent,
) -> Policy:
    """Trains a policy of images.

    Args:
        env: Worlds with observation "rgb_state".
        teacher: A policy of the state.
        spec: Of the student.
        folder: For checkpoints, images, `history.csv` and TensorBoard's events.
        options: Settings.
        seed: 0 or more.
        about: What worlds and teacher are, as JSON takes it: a checkpoint with another one is refused.
        on_round: Called with a seed at the beginning of a round, to draw new cousins.
        resume: Whether to go on from a checkpoint.
        report: Is told where the training stands.

    Returns:
        The best student, by its evaluations.

    Raises:
        InputError: A checkpoint cannot be used, or a file cannot be written.
    """
    told = {"options": asdict(options), "seed": seed, "spec": spec.to_document(), "worlds": env.num_envs}
    rounds = Rounds(folder, STAGE, {**told, **(about or {})}, seed, resume=resume)
    student = make_actor(spec)
    assert isinstance(student, ImageActor)
    optimizer = torch.optim.Adam(student.parameters(), options.learning_rate)
    logger = configure(str(folder / "tensorboard"), ["tensorboard"])
    frames, images = Frames(env.num_envs, spec.frames, options.keep), prepare_folder(folder / "images")
    if rounds.number:
        unpack(rounds.arrays, student, optimizer)
    for number in range(rounds.number):
        frames.add(Chunk.read(images / f"{number:04}.npz"))
    augment = Augment(options.shift, options.gain)
    while rounds.number < options.rounds:
        rounds.begin(env, on_round)
        generator = np.random.default_rng(np.random.randint(1 << 31))  # noqa: NPY002  # seeded by `begin`
        if rounds.number == 0:
            student = _fresh(spec)
            optimizer = torch.optim.Adam(student.parameters(), options.learning_rate)
        # In the first round the teacher acts: an untrained student would see little that matters.
        actor = teacher if rounds.number == 0 else Policy(spec, student)
        chunk = _collect(env, actor, teacher, options, generator)
        chunk.write(images / f"{rounds.number:04}.npz")
        frames.add(chunk)
        loss = _learn(student, optimizer, frames, augment, options, rounds.number, generator)
        found = evaluate_worlds(env, Policy(spec, student), options.episodes, seed=EVALUATION_SEED)
        rounds.end(pack(student, optimizer), student, found, steps=len(chunk.start), loss=loss, logger=logger)
        report(rounds.told(options.rounds))
    return Policy(spec, rounds.best_actor(spec))


def _fresh(spec: PolicySpec) -> ImageActor:
    """A network whose weights follow from the round's seed."""
    student = make_actor(spec)
    assert isinstance(student, ImageActor)
    return student


def _collect(
    env: VecEnv, actor: Policy, teacher: Policy, options: DistilOptions, generator: np.random.Generator
) -> Chunk:
    """Episodes of one policy, with the teacher's actions."""
    W = env.num_envs
    length = math.ceil(options.round_images / W)
    seen: Any = env.reset()
    height, width = seen["image"].shape[1:3]
    rows = W * length
    chunk = Chunk(
        np.empty((rows, height, width, 3), np.uint8),
        np.empty(rows, bool),
        np.empty((rows, 2), np.float32),
        np.empty((rows, POSE_SIZE), np.float32),
        np.empty((rows, ACTION_SIZE, len(LEVELS)), np.float32),
    )
    starts = np.ones(W, bool)
    for t in range(length):
        at = slice(t * W, (t + 1) * W)
        chunk.image[at] = seen["image"][..., -3:]
        chunk.start[at], chunk.pusher[at], chunk.pose[at] = starts, seen["pusher"], seen["state"][:, :POSE_SIZE]
        chunk.shares[at] = teacher.shares(seen)
        actions = actor.predict(seen)[0]
        noise = options.noise * generator.standard_normal((W, 2))
        seen, _, starts, _ = env.step(np.clip(actions + noise, -1.0, 1.0).astype(np.float32))
    return chunk


def _learn(
    student: ImageActor,
    optimizer: torch.optim.Optimizer,
    frames: Frames,
    augment: Augment,
    options: DistilOptions,
    number: int,
    generator: np.random.Generator,
) -> float:
    """Updates of a round; gives the mean loss of the last tenth of them."""
    losses = []
    total = options.rounds * options.updates
    for update in range(options.updates):
        share = (number * options.updates + update) / total
        rate = options.learning_rate * (0.01 + 0.99 * 0.5 * (1.0 + math.cos(math.pi * share)))
        for group in optimizer.param_groups:
            group["lr"] = rate
        images, pusher, pose, shares = frames.draw(options.batch_size, generator)
        dark = augment(student.darken(torch.from_numpy(images)))
        logits, poses = student.with_pose(dark, torch.from_numpy(pusher))
        loss = cross_entropy(logits.flatten(0, 1), torch.from_numpy(shares).flatten(0, 1))
        loss = loss + options.pose_weight * mse_loss(poses, torch.from_numpy(pose))
        optimizer.zero_grad()
        loss.backward()
        optimizer.step()
        losses.append(float(loss.detach()))
    return float(np.mean(losses[-max(1, len(losses) // 10) :]))
