"""The options of `pinwm simulate`, and the setup that they name."""

from dataclasses import dataclass
from pathlib import Path

from pinwm_drake.capture.episode_tables import TRAJECTORY_FILE
from pinwm_drake.errors import InputError, ParameterError
from pinwm_drake.systems.scenario.schema import ENGINES

STRAIGHT = "straight"
_USUAL_REACH = 0.085  # m, of the T-block, which the default camera sees well


@dataclass(frozen=True)
class SimulateOptions:
    """The options of `pinwm simulate`, named and in units as there.

    Raises:
        ParameterError: One is out of range.
    """

    engine: str | None
    seed: int | None
    duration: float | None
    push: str
    meshcat: bool
    host: str
    port: int | None
    record: Path | None
    video: Path | None
    out: Path | None

    def __post_init__(self) -> None:
        """Checks every option."""
        _require("--engine", self.engine, self.engine in (None, *ENGINES), ", ".join(ENGINES))
        _require("--seed", self.seed, self.seed is None or 0 <= self.seed < 2**32, "0 to 4294967295")
        _require("--duration", self.duration, self.duration is None or 0.01 <= self.duration <= 600, "0.01 to 600 s")
        for name, path, suffixes in (("--record", self.record, (".html", ".htm")), ("--video", self.video, (".mp4",))):
            fits = path is None or path.suffix.lower() in suffixes
            _require(name, path, fits, f"a name that ends in {' or '.join(suffixes)}")

    @property
    def log_folder(self) -> Path | None:
        """The folder of the trajectory.csv that is to be replayed; None for a straight push.

        Raises:
            InputError: `push` is something else.
        """
        if self.push == STRAIGHT:
            return None
        path = Path(self.push)
        if path.name != TRAJECTORY_FILE:
            raise InputError(self.push, allowed=f"{STRAIGHT}, or the path of a {TRAJECTORY_FILE}")
        return path.parent


def _require(name: str, value: object, allowed: bool, range_in_words: str) -> None:
    if not allowed:
        raise ParameterError(f"{name}: got {value}; allowed: {range_in_words}")
