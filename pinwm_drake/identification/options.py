# SPDX-License-Identifier: MIT
"""Options of an identification."""

from collections.abc import Mapping
from dataclasses import field
from typing import Annotated, Literal

from pydantic import Field

from pinwm_drake.request import ADVANCED, BUDGET, option, request

_MANY = 100_000
_Count = Annotated[int, Field(ge=1, le=_MANY)]
_CountFrom0 = Annotated[int, Field(ge=0, le=_MANY)]
_CountFrom2 = Annotated[int, Field(ge=2, le=_MANY)]
_Size = Annotated[float, Field(ge=8, le=4096)]


@request
class IdentifyOptions:
    """Options of the search for the unknowns.

    Attributes:
        free: Names of the free unknowns, see `unknowns.UNKNOWNS`; None for `unknowns.DEFAULT_FREE`.
        held: Physical values of unknowns that are held, or at which free ones begin.
        support: How the pressure on the face that the object rests on is spread: "auto" looks for it, "patch" holds it
            even, "corners" holds it as if the corners alone carried.
        seed: Seed of the random starts.
        screened: Number of random guesses that are rendered; eight times as many are tried without a rendering.
        starts: Number of the best of them that are followed to a minimum.
        coarse_iterations: Steps of Adam on small, blurred pictures, for every start.
        fine_iterations: Expansions of larger pictures at the most, for each of the best starts and each of two sizes.
        moves: Moves of each walker that draws from the posterior.
        coarse_size, fine_size: Longer side of the object in the pictures, px.
        coarse_frames, fine_frames: Frames of each push that the stages look at, evenly spaced.
        facets: Whether the object touches as its mesh, also where that is nearly round.
        time_step: Time step of the physics, s; None for that of the fastest push, see `time_step.time_step_of`.
        num_threads: Threads; None for one on each core.
        checkpoint_every: Steps between two checkpoints.
    """

    free: tuple[str, ...] | None = None
    held: Mapping[str, float] = field(default_factory=dict)
    support: Annotated[
        Literal["auto", "corners", "patch"],
        option("Pressure on the floor: estimated, at the corners, or even.", group=ADVANCED),
    ] = "auto"
    facets: Annotated[
        bool, option("Let the object touch as its mesh, also where that is nearly round.", group=ADVANCED)
    ] = False
    time_step: Annotated[
        float | None,
        option(
            "Time step of the physics, which the twin keeps.",
            group=ADVANCED,
            unit="s",
            ge=1e-5,
            le=0.1,
            default="1/240, or less where the pusher moves by over 5 mm in it",
        ),
    ] = None
    starts: Annotated[int, option("Number of random starts of the optimiser.", group=BUDGET, ge=1, le=1000)] = 4
    num_threads: Annotated[
        int | None, option("Number of threads.", "--threads", group=BUDGET, ge=1, default="one a core")
    ] = None
    seed: Annotated[int, option("Seed of the random starts.", group=ADVANCED, ge=0, le=2**63 - 1)] = 0
    screened: _Count = 64
    coarse_iterations: _CountFrom0 = 50
    fine_iterations: _CountFrom0 = 8
    moves: _CountFrom2 = 50
    coarse_size: _Size = 40.0
    fine_size: _Size = 130.0
    coarse_frames: _CountFrom2 = 12
    fine_frames: _CountFrom2 = 40
    checkpoint_every: _Count = 5

    def __post_init__(self) -> None:
        """Raise ParameterError where an unknown is free or held that there is not."""
        from pinwm_drake.identification.unknowns import DEFAULT_FREE, Coordinates

        if self.free is None:
            object.__setattr__(self, "free", DEFAULT_FREE)
        Coordinates(self.names, self.held)

    @property
    def names(self) -> tuple[str, ...]:
        """Names of the free unknowns."""
        assert self.free is not None
        return self.free

    @property
    def threads(self) -> int:
        """Threads of physics and renderer."""
        from pinwm_drake.threads import available

        return self.num_threads or available()
