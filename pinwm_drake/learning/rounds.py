"""Training in rounds: each begins from a seed of its own, so that one that was killed goes on with the same result.

What a round does depends on the networks, on the settings and on its number only: worlds, cousins and generators begin
anew. A checkpoint at the end of a round is therefore all that there is to keep.
"""

import csv
import io
import time
from collections.abc import Callable, Mapping
from dataclasses import asdict, dataclass
from pathlib import Path

import numpy as np
from stable_baselines3.common.logger import Logger
from stable_baselines3.common.utils import set_random_seed
from stable_baselines3.common.vec_env import VecEnv
from torch import nn

from pinwm_drake.checkpoints import read_arrays, write_arrays
from pinwm_drake.errors import ParameterError
from pinwm_drake.files import prepare_folder, replacing
from pinwm_drake.learning.evaluation import Evaluation
from pinwm_drake.learning.policy import make_actor
from pinwm_drake.learning.progress import Step
from pinwm_drake.learning.spec import PolicySpec
from pinwm_drake.learning.weights import set_weights, weights

CHECKPOINT_FILE, HISTORY_FILE = "checkpoint.npz", "history.csv"
OnRound = Callable[[int], None]
EVALUATION_SEED = 1_000_000  # of the first world, in every round: rounds are compared on the same starts
_BEST = "best."


@dataclass(frozen=True)
class Round:
    """What came of a round.

    Attributes:
        number: From 0.
        steps: Of the worlds, all rounds together.
        success: Share of the episodes of its evaluation that succeeded.
        length: Mean number of actions, of all of them: one that failed counts what it took, as a rule the limit.
        loss: Of its last update.
        seconds: Since the stage began, all runs together.
    """

    number: int
    steps: int
    success: float
    length: float
    loss: float
    seconds: float


class Rounds:
    """The memory of a stage of training, in a folder.

    Attributes:
        history: The rounds that are done.
        arrays: Of the checkpoint that was read; empty where there was none.
    """

    def __init__(self, folder: Path, stage: str, about: Mapping[str, object], seed: int, *, resume: bool) -> None:
        """Empty, or as an earlier run left it.

        Args:
            folder: Made if need be.
            stage: What messages call it.
            about: What the training depends on, as JSON takes it; a checkpoint of another one is refused.
            seed: 0 or more.
            resume: Whether to go on from a checkpoint, if there is one.

        Raises:
            InputError: The checkpoint cannot be read, or is of another training.
        """
        self.folder, self.stage = prepare_folder(folder), stage
        self._about, self._seed = dict(about), seed
        stored = read_arrays(folder / CHECKPOINT_FILE, self._about, stage, ["history"]) if resume else None
        self.arrays = {} if stored is None else stored
        rows = self.arrays.pop("history", np.zeros((0, 6)))
        self.history = [Round(int(row[0]), int(row[1]), *(float(value) for value in row[2:])) for row in rows]
        best = [name for name in self.arrays if name.startswith(_BEST)]
        self._weights = {name.removeprefix(_BEST): self.arrays.pop(name) for name in best}
        self._begun = time.monotonic() - self.seconds

    @property
    def number(self) -> int:
        """Of the round to come."""
        return len(self.history)

    @property
    def steps(self) -> int:
        """Of the worlds, so far."""
        return self.history[-1].steps if self.history else 0

    @property
    def seconds(self) -> float:
        """Of the rounds that are done."""
        return self.history[-1].seconds if self.history else 0.0

    @property
    def best(self) -> Round | None:
        """The round with the shortest episodes so far, the earliest of several."""
        return min(self.history, key=lambda one: one.length, default=None)

    def begin(self, env: VecEnv, on_round: OnRound | None = None) -> None:
        """Seeds the generators of python, numpy and torch, and the worlds, for the round to come.

        Args:
            env: The worlds; the seed counts from their next reset.
            on_round: Called with a seed of the round.
        """
        words = np.random.SeedSequence(self._seed, spawn_key=(_key(self.stage), self.number)).generate_state(2)
        set_random_seed(int(words[0]))
        if on_round is not None:
            on_round(int(words[1] >> 1))
        env.seed(int(words[1] >> 1))

    def end(
        self,
        arrays: Mapping[str, np.ndarray],
        actor: nn.Module,
        found: Evaluation,
        *,
        steps: int,
        loss: float,
        logger: Logger,
    ) -> None:
        """Keeps a round: the checkpoint, the table of all rounds, and TensorBoard's numbers.

        Args:
            arrays: What the next round begins with.
            actor: As it is now; its weights are kept where it is the best so far.
            found: Its evaluation.
            steps: Of the worlds, in this round.
            loss: Of the last update.
            logger: Takes the evaluation's numbers.

        Raises:
            InputError: A file cannot be written.
        """
        before, seconds = self.best, time.monotonic() - self._begun
        done = Round(self.number, self.steps + steps, found.success_rate, found.mean_steps, loss, seconds)
        if before is None or done.length < before.length:
            self._weights = weights(actor)
        self.history.append(done)
        rows = np.array([list(asdict(one).values()) for one in self.history], float)
        best = {f"{_BEST}{name}": value for name, value in self._weights.items()}
        write_arrays(self.folder / CHECKPOINT_FILE, self._about, {**arrays, **best, "history": rows})
        with replacing(self.folder / HISTORY_FILE) as path:
            path.write_text(_table(self.history))
        logger.record("evaluation/success", done.success)
        logger.record("evaluation/length", done.length)
        logger.dump(done.steps)

    def best_actor(self, spec: PolicySpec) -> nn.Module:
        """The network of the best round; raises ParameterError before the first."""
        if not self._weights:
            raise ParameterError(f"{self.stage}: got no round; allowed: 1 or more")
        actor = make_actor(spec)
        set_weights(actor, self._weights)
        return actor.eval()

    def told(self, total: int) -> Step:
        """Where the stage stands, of a number of rounds."""
        last, best = self.history[-1], self.best
        assert best is not None
        share = len(self.history) / total
        return Step(self.stage, share, last.steps, last.success, last.length, last.loss, best.success, last.seconds)


def _key(stage: str) -> int:
    return int.from_bytes(stage.encode()[:4], "little")


def _table(history: list[Round]) -> str:
    text = io.StringIO()
    writer = csv.DictWriter(text, list(asdict(history[0])), lineterminator="\n")
    writer.writeheader()
    writer.writerows(asdict(one) for one in history)
    return text.getvalue()
