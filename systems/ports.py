# SPDX-License-Identifier: MIT
"""Ports and cached values of Drake systems, declared as functions of a Context, and states that Drake need not copy."""

import weakref
from collections.abc import Callable
from typing import Any, TypeVar

from numpy.typing import ArrayLike
from pydrake.common.value import AbstractValue
from pydrake.systems.framework import CacheEntry, Context, DependencyTicket, Diagram, LeafSystem, ValueProducer
from pydrake.systems.sensors import ImageRgba8U

Tickets = set[DependencyTicket] | None  # of the sources that a value depends on; None for all
_Self = TypeVar("_Self")


class Immutable:
    """Value that never changes, so that a copy of it is the object itself: Drake copies a state whenever it is set."""

    def __deepcopy__(self: _Self, memo: dict[int, object]) -> _Self:
        return self


def unowned(system: LeafSystem, function: Callable[..., Any]) -> Callable[..., Any]:
    """Return a function for C++ to call that does not keep its system alive.

    A function that C++ holds, and that refers to the system, is a cycle that Python's garbage collector cannot see.
    The system and its diagram would never be freed (RobotLocomotion/drake, issue 24162). Here the system holds it.
    """
    kept, owner = vars(system).setdefault("_unowned", []), weakref.ref(system)
    number = len(kept)
    kept.append(function)
    return lambda *arguments: vars(owner())["_unowned"][number](*arguments)


def free_with(owner: object, diagram: Diagram) -> None:
    """Free a diagram once its owner is gone; its systems and ports must not be used any more then.

    Python 3.11 visits the attributes of systems that are written in Python twice, and never frees cycles among them.
    Ports are in such cycles with their systems, and systems with their diagram.
    """
    weakref.finalize(owner, _forget, diagram).atexit = False


def _forget(diagram: Diagram) -> None:
    for system in diagram.GetSystems():
        if isinstance(system, Diagram):
            _forget(system)
    for system in (*diagram.GetSystems(), diagram):
        vars(system).clear()


def declare_vector(
    system: LeafSystem, name: str, size: int, calc: Callable[[Context], ArrayLike], tickets: Tickets = None
) -> None:
    """Declare an output port of a vector (size,), which `calc` gives for a Context of the system."""
    sources = tickets or {system.all_sources_ticket()}
    write = unowned(system, lambda context, output: output.SetFromVector(calc(context)))
    system.DeclareVectorOutputPort(name, size, write, sources)


def declare_value(
    system: LeafSystem, name: str, model: object, calc: Callable[[Context], object], tickets: Tickets = None
) -> None:
    """Declare an output port of a value of the model's type, which `calc` gives for a Context of the system."""
    system.DeclareAbstractOutputPort(
        name,
        lambda: AbstractValue.Make(model),
        unowned(system, lambda context, output: output.set_value(calc(context))),
        tickets or {system.all_sources_ticket()},
    )


def declare_image(
    system: LeafSystem,
    name: str,
    size: tuple[int, int],
    calc: Callable[[Context], Any],
    tickets: Tickets,
    kind: type = ImageRgba8U,
) -> None:
    """Declare an output port of an image of Drake's, (width, height) px; `calc` gives the pixels."""

    def write(context: Context, output: AbstractValue) -> None:
        output.get_mutable_value().mutable_data[:] = calc(context)

    system.DeclareAbstractOutputPort(name, lambda: AbstractValue.Make(kind(*size)), unowned(system, write), tickets)


def declare_cache(system: LeafSystem, name: str, calc: Callable[[Context], object], tickets: Tickets) -> CacheEntry:
    """Declare a value that Drake keeps until one of its sources changes."""
    write = unowned(system, lambda context, value: value.set_value(calc(context)))
    producer = ValueProducer(allocate=lambda: AbstractValue.Make(object()), calc=write)
    return system.DeclareCacheEntry(name, producer, tickets)
