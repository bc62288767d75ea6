"""Which unknowns `pinwm identify` looks for, from its options."""

import math

from pinwm_drake.errors import ParameterError
from pinwm_drake.identification.unknowns import DEFAULT_FREE, NUISANCES, UNKNOWNS


def choose(
    free: list[str] | None, hold: list[str] | None, without: list[str] | None
) -> tuple[tuple[str, ...], dict[str, float]]:
    """The free unknowns and the values of held ones.

    Args:
        free: Names of physical ones to look for, instead of the default ones; nuisances are looked for as well.
        hold: NAME=VALUE; such an unknown is held, or begins there where `free` names it.
        without: Names to leave out.

    Returns:
        Names and values.

    Raises:
        ParameterError: A name is unknown, or a value is no number.
    """
    values = {}
    for text in hold or []:
        name, equals, number = text.partition("=")
        try:
            values[name] = float(number)
        except ValueError:
            values[name] = math.nan
        if not equals or not math.isfinite(values[name]):
            raise ParameterError(f"--hold: got {text!r}; allowed: NAME=VALUE, as in friction_pusher=0.2")
    for option, names in (("--free", free), ("--hold", list(values)), ("--without", without)):
        for name in names or []:
            if name not in UNKNOWNS:
                raise ParameterError(f"{option}: got {name!r}; allowed: {', '.join(UNKNOWNS)}")
    left_out = {*(without or []), *(name for name in values if name not in (free or []))}
    wanted = (*free, *NUISANCES) if free else DEFAULT_FREE
    chosen = tuple(name for name in wanted if name not in left_out)
    if not chosen:
        raise ParameterError("no unknown is left; allowed: one or more free ones")
    return tuple(dict.fromkeys(chosen)), values
