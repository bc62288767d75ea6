"""The settings of hydroelastic contact that the study changes, one at a time."""

from collections.abc import Iterator
from contextlib import ExitStack, contextmanager
from dataclasses import dataclass
from types import SimpleNamespace
from unittest import mock

from pydrake.multibody.plant import DiscreteContactApproximation

from pinwm_drake.systems.engines.plant import scene as push_plant
from pinwm_drake.systems.sdf import contact
from pinwm_drake.systems.sdf import twin as twin_model


@dataclass(frozen=True)
class Variant:
    """A change of one setting.

    Attributes:
        name: Name of the setting that is changed.
        value: Value of the setting, for the table.
        patches: Module and name of a constant, and its value.
        time_step: s, of the plant; None for its own.
    """

    name: str
    value: str
    patches: tuple[tuple[object, str, object], ...] = ()
    time_step: float | None = None


def _scaled(
    name: str, constant: str, unit: str, factors: tuple[float, ...], module: object = contact
) -> Iterator[Variant]:
    for factor in factors:
        value = factor * getattr(contact, constant)
        patches = tuple((where, constant, value) for where in {contact, module})
        yield Variant(f"{name} × {factor:g}", f"{value:g} {unit}", patches)


def _approximation(name: str) -> Variant:
    stand_in = SimpleNamespace(kLagged=getattr(DiscreteContactApproximation, f"k{name}"))
    return Variant(f"approximation: {name}", "", ((push_plant, "DiscreteContactApproximation", stand_in),))


def variants() -> list[Variant]:
    """Variants of the study; the first one changes nothing."""
    tenfold, twofold = (0.1, 10.0), (0.5, 2.0)
    return [
        Variant("as it is", ""),
        *_scaled("modulus of the floor", "FLOOR_MODULUS", "Pa", tenfold),
        *_scaled("modulus of the pusher", "PUSHER_MODULUS", "Pa", tenfold),
        *_scaled("dissipation of the floor", "FLOOR_DISSIPATION", "s/m", tenfold),
        *_scaled("dissipation of the pusher", "_NO_BOUNCE", "s/m", tenfold),
        *_scaled("resolution hint of the pusher", "PUSHER_RESOLUTION", "m", twofold),
        *_scaled("triangles of the object", "LONGEST_EDGE", "of its mean extent", twofold, twin_model),
        *(Variant(f"time step 1/{n} s", "", time_step=1 / n) for n in (960, 1920, 7680)),
        *(_approximation(name) for name in ("Similar", "Sap")),
    ]


@contextmanager
def applied(variant: Variant) -> Iterator[None]:
    """Has the plants that are made within the block the setting of a variant."""
    with ExitStack() as stack:
        for module, name, value in variant.patches:
            stack.enter_context(mock.patch.object(module, name, value))
        yield
