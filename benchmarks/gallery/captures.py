# SPDX-License-Identifier: MIT
"""Six objects of the gallery, and a capture of two pushes of each in Drake's hydroelastic plant."""

from dataclasses import dataclass
from pathlib import Path

from benchmarks.next_push.captures import write_capture
from benchmarks.next_push.objects import make_thing
from benchmarks.next_push.poses import pose_capture
from benchmarks.next_push.specification import CAPTURES

PIXELS, VIEWS, PUSHES = 240, 18, 2
_SEED, _FRAMES, _RATE = 7, 24, 12  # of a push; Hz


@dataclass(frozen=True)
class Exhibit:
    """Object of the gallery.

    Attributes:
        name: Name of its files, and of the object where it ships.
        title: Its name in words.
        friction: Friction coefficient of object and floor; None where a specification draws it.
        specification: Name of a capture of `benchmarks.next_push`, for an object that does not ship.
    """

    name: str
    title: str
    friction: float | None = None
    specification: str = ""

    @property
    def capture_command(self) -> str:
        """Options of the command that makes the capture, but for its folder; empty where none does."""
        if self.specification:
            return ""
        return (
            f"--object {self.name} --friction {self.friction:g} --size {PIXELS} --static-views {VIEWS} "
            f"--frames {_FRAMES} --rate {_RATE} --seed {_SEED}"
        )

    def write_capture(self, out: Path) -> None:
        """Write the capture of an object that does not ship into a folder that is not there yet."""
        spec = next(spec for spec in CAPTURES if spec.name == self.specification)
        thing = make_thing(spec.thing, out.parent / "objects")
        write_capture(out, spec, thing, pose_capture(spec, thing, number=PUSHES), pixels=PIXELS, views=VIEWS)


EXHIBITS = (
    Exhibit("t_block", "T-block", 0.03),
    Exhibit("large_t", "Large T", 0.05),
    Exhibit("l", "L", specification="l_hydroelastic"),
    Exhibit("cube", "Cube", 0.1),
    Exhibit("mug", "Mug", 0.2),
    Exhibit("mug_handle", "Mug with handle", 0.15),
)
