# SPDX-License-Identifier: MIT
"""Training in rounds: each begins from a seed of its own, so that one that was killed goes on with the same result.

A round depends on the networks, on the settings and on its number only: worlds, domains and generators begin anew. A
checkpoint at the end of a round is therefore all that there is to keep between rounds. Within a round, the generators
and the worlds' states are kept beside the networks, so that a round too goes on bit by bit.
"""

import csv
import io
import json
import math
import random
import time
import weakref
from collections.abc import Callable, Mapping
from dataclasses import asdict, dataclass, field, replace
from pathlib import Path
from typing import Any

import numpy as np
import torch
from stable_baselines3.common.logger import KVWriter, configure
from stable_baselines3.common.utils import set_random_seed
from stable_baselines3.common.vec_env import VecEnv
from torch import nn

from pinwm_drake.checkpoints import Resumable, read_arrays, write_arrays
from pinwm_drake.errors import InputError, ParameterError, require
from pinwm_drake.files import prepare_folder, replacing
from pinwm_drake.learning.evaluation import Evaluation
from pinwm_drake.learning.policy import make_actor
from pinwm_drake.learning.progress import Report, Step, silent
from pinwm_drake.learning.spec import PolicySpec
from pinwm_drake.learning.weights import set_weights, weights
from pinwm_drake.pace import Pace
from pinwm_drake.reading.contents import guarded
from pinwm_drake.reading.tables import read_rows
from pinwm_drake.reading.trees import parse_json

CHECKPOINT_FILE, HISTORY_FILE = "checkpoint.npz", "history.csv"
ROUND_FILE = "round.npz"  # the state of a round that is not done
OnRound = Callable[[int], None]
EVALUATION_SEED = 1_000_000  # seed of the first world, in every round: rounds are compared on the same starts
_BEST, _WORLDS = "best.", "worlds."
_LITTLE = 0.05  # of the episodes' length, by which a round has to be better to count
_ALIKE = 0.03  # of success, about a standard error of 128 episodes: nearer rounds are told apart by their length
_NEARLY = 0.99  # share of a stage that is told at most, of one that ends with its budget
_PERIOD = 30.0  # s, between two checkpoints within a round, at least


@dataclass(frozen=True)
class Round:
    """Result of one round.

    Attributes:
        number: Number of the round, from 0.
        steps: Number of steps of all worlds, all rounds so far together.
        success: Share of the episodes of its evaluation that succeeded, 0 to 1.
        length: Mean number of actions of those episodes: one that failed counts what it took, as a rule the limit.
        loss: Loss at the end of the round.
        seconds: s, time since the stage began, all runs together.
    """

    number: int
    steps: int
    success: float
    length: float
    loss: float
    seconds: float


@dataclass(frozen=True)
class Until:
    """End of a stage before its last round.

    Attributes:
        target: Share of an evaluation's episodes with success from which the stage is over; infinite for none.
        minutes: min, all runs together, that the stage may take, judged by its last round; infinite for any. One round
            is done in any case.

    Raises:
        ParameterError: A number is not positive.
    """

    target: float = math.inf
    minutes: float = math.inf

    def __post_init__(self) -> None:
        require("target", self.target, 0.0 < self.target <= 1.0 or self.target == math.inf, "more than 0, up to 1")
        require("minutes", self.minutes, self.minutes > 0.0, "more than 0")

    def within(self, minutes: float) -> "Until":
        """End with the same target and other minutes, at least a second."""
        return replace(self, minutes=max(minutes, 1.0 / 60.0))


ANY = Until()


def _as_good(one: Round, best: Round) -> bool:
    return one.success >= best.success - _ALIKE and one.length <= best.length * (1.0 + _LITTLE)


def minutes_of(folder: Path) -> float:
    """Minutes that a stage took, by its table of rounds; 0 where there is none."""
    path = folder / HISTORY_FILE
    if not path.exists():
        return 0.0
    (_, header), *rows = read_rows(path) or [(1, [])]
    try:
        return float(rows[-1][1][header.index("seconds")]) / 60.0 if rows else 0.0
    except (ValueError, IndexError) as error:
        raise InputError(path, value=error, allowed="a table of rounds with their seconds") from error


@dataclass(frozen=True)
class StageRun:
    """One run of a stage of training.

    Attributes:
        folder: Folder of checkpoints, `history.csv` and TensorBoard's events; made if need be.
        stage: Name of the stage in progress and messages.
        seed: Seed of networks and worlds, 0 or more.
        about: Description of worlds and data, as JSON takes it: a checkpoint with another one is refused.
        on_round: Called with a seed at the beginning of a round, before worlds are reset, to draw its domains.
        resume: Flag: the stage goes on from a checkpoint, where there is one.
        until: What ends it before its last round; a continued stage may have another one.
        device: Device of the networks, as torch names it; the policy that is returned is on the CPU.
        report: Called with the progress of the stage.
    """

    folder: Path
    stage: str
    seed: int = 0
    about: Mapping[str, object] = field(default_factory=dict)
    on_round: OnRound | None = None
    resume: bool = False
    until: Until = ANY
    device: str = "cpu"
    report: Report = silent

    def telling(self, options: Any, spec: PolicySpec, env: VecEnv) -> "StageRun":
        """Return the run; its description names settings (a dataclass), seed, specification and worlds."""
        told = {"options": asdict(options), "seed": self.seed, "spec": spec.to_document(), "worlds": env.num_envs}
        return replace(self, about={**told, **self.about})


class Rounds:
    """The memory of a stage of training, in a folder.

    Attributes:
        folder: Folder of the checkpoints.
        stage: Name of the stage.
        total: Number of rounds of the stage.
        history: The rounds that are done.
        arrays: Arrays of the checkpoint that was read; empty where there was none.
        logger: TensorBoard's logger.
    """

    def __init__(self, run: StageRun, total: int) -> None:
        """Begins empty, or as an earlier run left the stage.

        Args:
            run: The run, whose description names everything that the training depends on.
            total: Number of rounds of the stage.

        Raises:
            InputError: The checkpoint cannot be read, or is of another training.
        """
        self.folder, self.stage, self._run = prepare_folder(run.folder), run.stage, run
        self._about = dict(run.about)
        stored = read_arrays(self.folder / CHECKPOINT_FILE, self._about, run.stage, ["history"]) if run.resume else None
        self.arrays = {} if stored is None else stored
        rows = self.arrays.pop("history", np.zeros((0, 6)))
        _check_rows(self.folder / CHECKPOINT_FILE, rows, total)
        self.history = [Round(int(row[0]), int(row[1]), *(float(value) for value in row[2:])) for row in rows]
        best = [name for name in self.arrays if name.startswith(_BEST)]
        self._weights = {name.removeprefix(_BEST): self.arrays.pop(name) for name in best}
        self.total, self._resume, self._pace = total, run.resume, Pace()
        self.logger = configure(str(self.folder / "tensorboard"), ["tensorboard"])
        # Its file and thread end with the logger, even where the training ends by an exception.
        weakref.finalize(self.logger, _close, self.logger.output_formats)
        self._begun = time.monotonic() - self.seconds
        self._kept = time.monotonic()
        self.tell()

    @property
    def number(self) -> int:
        """Number of the next round."""
        return len(self.history)

    @property
    def steps(self) -> int:
        """Number of steps of all worlds in the rounds that are done."""
        return self.history[-1].steps if self.history else 0

    @property
    def seconds(self) -> float:
        """Time [s] of the rounds that are done, all runs together."""
        return self.history[-1].seconds if self.history else 0.0

    @property
    def best(self) -> Round | None:
        """Best round by its evaluation: most success, and of those within 3 % of that the shortest; None at first.

        Where no round had any success, it is the last one.
        """
        best, most = None, 0.0
        for one in self.history:
            most = max(most, one.success)
            lost = best is None or best.success < most - _ALIKE or most == 0.0
            if lost or (best is not None and one.success >= most - _ALIKE and one.length < best.length):
                best = one
        return best

    def ended(self, patience: int) -> bool:
        """Flag: all rounds are done, or one succeeded mostly and `patience` ones after it were hardly better.

        So it is where a round has reached the target, or the next one would take too long.
        """
        best, until = self.best, self._run.until
        if best is None:
            return self.number >= self.total
        before = self.history[-2].seconds if len(self.history) > 1 else 0.0
        if best.success >= until.target or 2.0 * self.seconds - before > 60.0 * until.minutes:
            return True
        if best.success <= 0.8:
            return self.number >= self.total
        enough = next(one for one in self.history if _as_good(one, best))
        return self.number >= self.total or self.number - 1 - enough.number >= patience

    def spent(self, done: float) -> float:
        """Share of the minutes that the stage may take, which is spent; 0 where there is no limit.

        Args:
            done: Share of the next round that is done; it takes as long as the last one.
        """
        before = self.history[-2].seconds if len(self.history) > 1 else 0.0
        return (self.seconds + done * (self.seconds - before)) / (60.0 * self._run.until.minutes)

    def falling(self, last: float) -> float:
        """Share of the first learning rate that the next round has: it falls evenly from 1, to `last` after all."""
        return 1.0 - (1.0 - last) * self.number / self.total

    def begin(self, env: VecEnv) -> None:
        """Seeds the generators of python, numpy and torch, and the worlds from their next reset, for the next round."""
        key = int.from_bytes(self.stage.encode()[:4], "little")
        words = np.random.SeedSequence(self._run.seed, spawn_key=(key, self.number)).generate_state(2)
        set_random_seed(int(words[0]))
        if self._run.on_round is not None:
            self._run.on_round(int(words[1] >> 1))
        env.seed(int(words[1] >> 1))

    def due(self, env: VecEnv) -> bool:
        """Flag: the worlds are `Resumable`, and it is 30 s since the last time that a round was kept."""
        return isinstance(env, Resumable) and time.monotonic() - self._kept >= _PERIOD

    def keep(self, env: VecEnv, arrays: Mapping[str, np.ndarray]) -> None:
        """Keep a round that goes on.

        Args:
            env: The worlds, which are `Resumable`.
            arrays: Arrays that the training needs to go on; generators and worlds are added.

        Raises:
            InputError: The file cannot be written.
        """
        assert isinstance(env, Resumable)
        worlds = {f"{_WORLDS}{name}": values for name, values in env.get_state().items()}
        mine = {"number": np.array(self.number), "seconds": np.array(time.monotonic() - self._begun)}
        kept = {**arrays, **worlds, **_generators(), **mine}
        write_arrays(self.folder / ROUND_FILE, self._about, kept)
        self._kept = time.monotonic()

    def restore(self, env: VecEnv) -> dict[str, np.ndarray] | None:
        """Put generators, worlds and time into the state in which an earlier run kept the round that has just begun.

        Args:
            env: The worlds.

        Returns:
            The arrays that `keep` was given; None where the round begins anew.

        Raises:
            InputError: The file cannot be read, or is of another training.
        """
        if not self._resume or not isinstance(env, Resumable):
            return None
        self._resume = False  # Later rounds are of this run.
        arrays = read_arrays(self.folder / ROUND_FILE, self._about, self.stage, ["number"])
        if arrays is None or int(arrays.pop("number")) != self.number:
            return None
        self._begun = time.monotonic() - float(arrays.pop("seconds", self.seconds))
        worlds = [name for name in arrays if name.startswith(_WORLDS)]
        with guarded(self.folder / ROUND_FILE, f"a checkpoint of `{self.stage}`"):
            env.set_state({name.removeprefix(_WORLDS): arrays.pop(name) for name in worlds})
            _set_generators(arrays)
        return arrays

    def end(
        self, arrays: Mapping[str, np.ndarray], actor: nn.Module, found: Evaluation, *, steps: int, loss: float
    ) -> None:
        """End a round: writes the checkpoint, the table of all rounds, and TensorBoard's numbers.

        Args:
            arrays: Arrays that the next round begins with.
            actor: The network at the end of the round; its weights are kept where it is the best so far.
            found: Evaluation of the network.
            steps: Number of steps of all worlds in this round.
            loss: Loss at the end of the round.

        Raises:
            InputError: A file cannot be written.
        """
        seconds = time.monotonic() - self._begun
        done = Round(self.number, self.steps + steps, found.success_rate, found.mean_steps, loss, seconds)
        self.history.append(done)
        if self.best is done:
            self._weights = weights(actor)
        rows = np.array([list(asdict(one).values()) for one in self.history], float)
        best = {f"{_BEST}{name}": value for name, value in self._weights.items()}
        write_arrays(self.folder / CHECKPOINT_FILE, self._about, {**arrays, **best, "history": rows})
        (self.folder / ROUND_FILE).unlink(missing_ok=True)
        with replacing(self.folder / HISTORY_FILE) as path:
            path.write_text(_table(self.history))
        self.logger.record("evaluation/success", done.success)
        self.logger.record("evaluation/length", done.length)
        self.logger.dump(done.steps)
        self.tell()

    def best_weights(self) -> dict[str, np.ndarray]:
        """Weights of the network of the best round, by name; raises ParameterError before the first."""
        if not self._weights:
            raise ParameterError(f"{self.stage}: no round has ended; train on until one has")
        return self._weights

    def best_actor(self, spec: PolicySpec) -> nn.Module:
        """Return the network of the best round; raises ParameterError before the first."""
        actor = make_actor(spec)
        set_weights(actor, self.best_weights())
        return actor.eval()

    def tell(self, share: float = 0.0, *, steps: int = 0, loss: float = math.nan, recent: float = math.nan) -> None:
        """Report the progress of the stage.

        Args:
            share: Share of the round that goes on, 0 to 1.
            steps: Number of steps of all worlds in that round.
            loss: Loss of the last update in it; NaN for that of the last round.
            recent: Share of the last episodes of the training itself that succeeded; NaN where it is not known.
        """
        last = self.history[-1] if self.history else Round(0, 0, math.nan, math.nan, math.nan, 0.0)
        best, done, steps = self.best or last, (self.number + share) / self.total, self.steps + steps
        seconds = time.monotonic() - self._begun
        rate, left = self._pace(done, steps)
        done, left = self._within_budget(done, left, seconds)
        step = Step(
            stage=self.stage,
            done=done,
            steps=steps,
            success=last.success,
            length=last.length,
            loss=last.loss if math.isnan(loss) else loss,
            best=best.success,
            seconds=seconds,
            recent=recent,
            rate=rate,
            left=left,
        )
        self._run.report(step)

    def _within_budget(self, done: float, left: float, seconds: float) -> tuple[float, float]:
        """Share that is done and time that is left [s], where the budget ends before the last round.

        Args:
            done: Share of all rounds that is done.
            left: s, until the last round is done at the pace so far; NaN where that is not known.
            seconds: s, that the stage took until now.
        """
        budget = 60.0 * self._run.until.minutes
        if math.isinf(budget) or done >= 1.0:
            return done, left
        rest = max(budget - seconds, 0.0)
        if not self.history and done > 0.0:  # the first round is done in any case
            first = left * max(1.0 / self.total - done, 0.0) / (1.0 - done)
            rest = rest if math.isnan(first) else max(rest, first)
        left = rest if math.isnan(left) else min(left, rest)
        return max(done, min(seconds / max(seconds + left, 1e-9), _NEARLY)), left


def _close(formats: list[KVWriter]) -> None:
    for one in formats:
        one.close()


_STATE = Path("state of a generator")  # in messages


def _generators() -> dict[str, np.ndarray]:
    legacy: Any = np.random.get_state(legacy=False)  # noqa: NPY002  # SB3 draws from it
    legacy["state"]["key"] = legacy["state"]["key"].tolist()
    return {
        "random.python": np.array(json.dumps(random.getstate())),
        "random.numpy": np.array(json.dumps(legacy)),
        "random.torch": torch.get_rng_state().numpy(),
    }


def _set_generators(arrays: Mapping[str, np.ndarray]) -> None:
    version, words, gauss = parse_json(str(arrays["random.python"]), _STATE)
    random.setstate((version, tuple(words), gauss))
    np.random.set_state(parse_json(str(arrays["random.numpy"]), _STATE))  # noqa: NPY002
    torch.set_rng_state(torch.from_numpy(arrays["random.torch"]))


def _check_rows(path: Path, rows: np.ndarray, total: int) -> None:
    """Raise InputError where rows of a checkpoint are not those of rounds 0, 1, 2 ... of `total`."""
    fits = rows.dtype.kind == "f" and rows.ndim == 2 and rows.shape[1] == 6 and len(rows) <= total
    if fits:
        number, steps, success, seconds = rows[:, 0], rows[:, 1], rows[:, 2], rows[:, 5]
        fits = bool((number == np.arange(len(rows))).all() and (np.diff(steps, prepend=0.0) >= 0.0).all())
        fits = fits and bool(
            ((success >= 0.0) & (success <= 1.0)).all() and (np.diff(seconds, prepend=0.0) >= 0.0).all()
        )
    if not fits:
        value = f"a history of {rows.dtype} {rows.shape} that is none of rounds"
        raise InputError(path, value=value, allowed=f"a row for each round, {total} at most")


def _table(history: list[Round]) -> str:
    text = io.StringIO()
    writer = csv.DictWriter(text, list(asdict(history[0])), lineterminator="\n")
    writer.writeheader()
    writer.writerows(asdict(one) for one in history)
    return text.getvalue()
