"""Options of an identification."""

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Literal

from pinwm_drake.errors import ParameterError
from pinwm_drake.identification.unknowns import DEFAULT_FREE, Coordinates
from pinwm_drake.scene import Support
from pinwm_drake.threads import available


@dataclass(frozen=True)
class IdentifyOptions:
    """Options of the search for the unknowns.

    Attributes:
        free: Names of the free unknowns; see `unknowns.UNKNOWNS`.
        held: Physical values of unknowns that are held, or at which free ones begin.
        support: How the pressure on the face that the object rests on is spread: "auto" looks for it, "patch" holds it
            even, "corners" holds it as if the corners alone carried.
        seed: Seed of the random starts.
        screened: Number of random guesses that are evaluated.
        starts: Number of the best of them, from which Adam descends.
        coarse_iterations: Steps of Adam on small, blurred pictures, for every start.
        fine_iterations: Expansions of larger pictures at the most, for each of the best starts and each of two sizes.
        moves: Moves of each walker that draws from the posterior.
        coarse_size, fine_size: Longer side of the object in the pictures, px.
        coarse_frames, fine_frames: Frames of each push that the stages look at, evenly spaced.
        time_step: Time step of the physics, s.
        num_threads: Threads; None for one on each core.
        checkpoint_every: Steps between two checkpoints.
    """

    free: tuple[str, ...] = DEFAULT_FREE
    held: Mapping[str, float] = field(default_factory=dict)
    support: Literal["auto"] | Support = "auto"
    seed: int = 0
    screened: int = 64
    starts: int = 4
    coarse_iterations: int = 50
    fine_iterations: int = 8
    moves: int = 50
    coarse_size: float = 40.0
    fine_size: float = 130.0
    coarse_frames: int = 12
    fine_frames: int = 40
    time_step: float = 1.0 / 240.0
    num_threads: int | None = None
    checkpoint_every: int = 5

    def __post_init__(self) -> None:
        """Raises ParameterError where an option is out of its range."""
        Coordinates(self.free, self.held)
        for name, low, high in (
            ("seed", 0, 2**63 - 1),
            ("screened", 1, 100_000),
            ("starts", 1, 1000),
            ("coarse_iterations", 0, 100_000),
            ("fine_iterations", 0, 100_000),
            ("moves", 2, 100_000),
            ("coarse_frames", 2, 100_000),
            ("fine_frames", 2, 100_000),
            ("checkpoint_every", 1, 100_000),
            ("coarse_size", 8.0, 4096.0),
            ("fine_size", 8.0, 4096.0),
            ("time_step", 1e-5, 0.05),
        ):
            value = getattr(self, name)
            whole = isinstance(value, int) and not isinstance(value, bool)
            if (isinstance(low, int) and not whole) or not low <= value <= high:
                words = f"{low} to {high}" if isinstance(low, int) else f"{low:g} to {high:g}"
                raise ParameterError(f"{name} is {value}; allowed: {words}")
        if self.num_threads is not None and self.num_threads < 1:
            raise ParameterError(f"num_threads is {self.num_threads}; allowed: at least 1")
        if self.support not in ("auto", "corners", "patch"):
            raise ParameterError(f"support is {self.support!r}; allowed: auto, corners or patch")

    @property
    def threads(self) -> int:
        """Threads of physics and renderer."""
        return self.num_threads or available()
