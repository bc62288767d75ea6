# SPDX-License-Identifier: MIT
"""Map from the columns of a log to the motion of the pusher, with units that are stated or guessed aloud.

    t=stamp[ms],px=x[mm],py=-y[mm],pz=0.05[m],yaw=heading[deg],vx=speed_x[mm/s],fx=force_x[N]

On the left stands a name of the capture, on the right a column, its unit in brackets, or a constant.
"""

import re
from dataclasses import dataclass

import numpy as np

from pinwm_drake.capture.episode_tables import FORCE, POSITION, QUATERNION, VELOCITY, PusherTrajectory, quote
from pinwm_drake.capture.importers.film import Columns, counted, in_order, time_unit
from pinwm_drake.errors import InputError, ParameterError

_LENGTHS = {"m": 1.0, "cm": 1e-2, "mm": 1e-3, "um": 1e-6, "in": 0.0254}
_TIMES = {"s": 1.0, "ms": 1e-3, "us": 1e-6, "ns": 1e-9, "min": 60.0}
_ANGLES = {"rad": 1.0, "deg": np.pi / 180}
_SPEEDS = {f"{name}/s": value for name, value in _LENGTHS.items()}
_FORCES = {"N": 1.0, "mN": 1e-3, "kN": 1e3}
_UNITS: dict[str, dict[str, float]] = {
    "t": _TIMES,
    **dict.fromkeys(POSITION, _LENGTHS),
    **{key: {"1": 1.0} for key in QUATERNION},
    "yaw": _ANGLES,
    **dict.fromkeys(VELOCITY, _SPEEDS),
    **dict.fromkeys(FORCE, _FORCES),
}
# Names under which logs often have them, without their unit and in small letters.
_OFTEN = {
    "t": ("t", "time", "stamp", "timestamp", "time_stamp"),
    **{name: (name, name[1], f"pos_{name[1]}", f"position_{name[1]}", f"position.{name[1]}") for name in POSITION},
    **{name: (name, f"q_{name[1]}", f"quat_{name[1]}", f"orientation.{name[1]}") for name in QUATERNION},
    "yaw": ("yaw", "theta"),
    **{name: (name, f"vel_{name[1]}", f"linear.{name[1]}") for name in VELOCITY},
    **{name: (name, f"force_{name[1]}", f"force.{name[1]}") for name in FORCE},
}
_ENTRY = re.compile(r"(?P<name>\w+)\s*=\s*(?P<sign>[-+]?)(?P<column>[^\[\]]+?)\s*(\[(?P<unit>[^\[\]]*)\])?\s*")
_NAMED_UNIT = re.compile(r"(.+?)\s*[\[(]([^\])]+)[\])]")
_INDEX = re.compile(r"\[(\d+)\]")  # of an element: state[0] is written state.0
_LONGEST_WAY = 5.0  # m: of a longer one in metres, millimetres are meant
_NORM = 1e-3
_NEAR = 1.6  # between speeds and those that positions have


@dataclass(frozen=True)
class Source:
    """Column or constant that a name of the capture is taken from; `factor` to SI units, None where it is guessed."""

    column: str
    factor: float | None
    sign: float = 1.0
    constant: float | None = None


def parse_columns(text: str) -> dict[str, Source]:
    """Sources of the capture's names from the text of the option `--columns`.

    Raises:
        ParameterError: An entry is no NAME=COLUMN[UNIT], a name or unit is unknown, or a name comes twice.
    """
    found: dict[str, Source] = {}
    for entry in filter(None, (part.strip() for part in _INDEX.sub(r".\1", text).split(","))):
        match = _ENTRY.fullmatch(entry)
        if match is None:
            raise ParameterError(f"--columns: got {quote(entry)}; allowed: NAME=COLUMN[UNIT], such as px=x[mm]")
        name = match["name"]
        if name not in _UNITS:
            raise ParameterError(f"--columns: got {quote(name)}; allowed: {', '.join(_UNITS)}")
        if name in found:
            raise ParameterError(f"--columns: got {name} twice; allowed: each name once")
        found[name] = _source(name, match["column"], match["unit"], -1.0 if match["sign"] == "-" else 1.0)
    return found


def _source(name: str, column: str, unit: str | None, sign: float) -> Source:
    if unit is not None and unit not in _UNITS[name]:
        raise ParameterError(f"--columns: got {name} in [{unit}]; allowed: {', '.join(_UNITS[name])}")
    factor = None if unit is None else _UNITS[name][unit]
    try:
        constant = float(column)
    except ValueError:
        constant = None
    return Source(column, factor, sign, constant)


def guessed_columns(log: Columns, given: dict[str, Source]) -> tuple[dict[str, Source], list[str]]:
    """Return the given sources and those that names of columns tell, with notes that say what was guessed."""
    if given:
        return (given if "t" in given or not log.time else {"t": Source(log.time, 1.0), **given}), []
    plain: dict[str, tuple[str, str | None]] = {}
    for column in log.values:
        match = _NAMED_UNIT.fullmatch(column)
        plain.setdefault((match[1] if match else column).strip().lower(), (column, match[2] if match else None))
    found: dict[str, Source] = {}
    for name, others in _OFTEN.items():
        for other in others:
            if other in plain and name not in found:
                column, unit = plain[other]
                found[name] = Source(column, _UNITS[name].get(unit or ""))
    if log.time:
        found["t"] = Source(log.time, 1.0)
    words = ",".join(f"{name}={one.column}" for name, one in found.items() if name != one.column)
    return found, [f"columns guessed: {words}"] if words else []


def make_trajectory(log: Columns, given: dict[str, Source]) -> tuple[PusherTrajectory, list[str]]:
    """Motion of the pusher from a log, by the clock of the log; velocities by differences where it has none.

    Args:
        log: The log.
        given: Sources by name; empty to guess them by the names of columns.

    Returns:
        The motion, and notes on what was guessed, dropped and missing.

    Raises:
        InputError: A column is missing, a unit cannot be told, or too few rows are left.
    """
    sources, notes = guessed_columns(log, given)
    notes = [*log.notes, *notes]
    for name in ("t", *POSITION[:2]):
        if name not in sources:
            allowed = f"--columns with {name}=COLUMN[UNIT]; the log has {', '.join(list(log.values)[:12])}"
            raise InputError(log.path, value=f"no column for {name}", allowed=allowed)
    raw = {name: _column(log, name, source) for name, source in sources.items()}
    t = raw["t"] * _time_factor(log, sources["t"], raw["t"], notes)
    needed = [name for name in raw if name not in FORCE]
    t = np.where(np.isfinite(np.array([raw[name] for name in needed])).all(0), t, np.nan)
    kept, told = in_order(log.path, t, "row")
    notes += told
    raw, t = {name: values[kept] for name, values in raw.items()}, t[kept]
    p_WP = _positions(log, sources, raw, notes)
    v_WP = np.zeros_like(p_WP)
    v_WP[:-1] = np.diff(p_WP, axis=0) / np.diff(t)[:, None]
    if all(name in raw for name in VELOCITY[:2]):
        v_WP = _velocities(sources, raw, v_WP, notes)
    forces = [name for name in FORCE if name in raw]
    force_W = None
    if len(forces) == 3:
        force_W = np.stack([np.nan_to_num(raw[name]) * (sources[name].factor or 1.0) for name in FORCE], axis=1)
    elif forces:
        raise InputError(log.path, value=f"only {', '.join(forces)}", allowed="fx, fy and fz, or none of them")
    return PusherTrajectory(t, p_WP, _orientations(log, sources, raw, len(t)), v_WP, force_W), notes


def _column(log: Columns, name: str, source: Source) -> np.ndarray:
    if source.constant is not None and source.column not in log.values:  # 1, 2, 3 are columns without a header
        return np.full(len(log.rows), source.sign * source.constant)
    if source.column not in log.values:
        allowed = f"a column of the log: {', '.join(list(log.values)[:12])}"
        raise InputError(log.path, value=f"no column {quote(source.column)} for {name}", allowed=allowed)
    return source.sign * log.values[source.column]


def _time_factor(log: Columns, source: Source, values: np.ndarray, notes: list[str]) -> float:
    if source.factor is not None:
        return source.factor
    unit, factor = time_unit(log.path, values)
    if unit != "s":
        notes.append(f"t taken for {unit}: state it as t={source.column}[{unit}]")
    return factor


def _positions(log: Columns, sources: dict[str, Source], raw: dict[str, np.ndarray], notes: list[str]) -> np.ndarray:
    guess = [name for name in POSITION if name in raw and sources[name].factor is None]
    factor = 1.0
    if guess:
        way = float(np.linalg.norm([np.ptp(raw[name]) for name in guess]))
        factor = 1.0 if way <= _LONGEST_WAY else 1e-3
        if factor < 1:
            first = sources[guess[0]].column
            notes.append(f"{', '.join(guess)} taken for mm (a way of {way:.4g}): state it as {guess[0]}={first}[mm]")
    if "pz" not in raw:
        raise InputError(log.path, value="no column for pz", allowed="--columns with pz=COLUMN[UNIT] or pz=HEIGHT[m]")
    return np.stack(
        [raw[name] * (sources[name].factor or _constant(log, sources[name], factor)) for name in POSITION], axis=1
    )


def _constant(log: Columns, source: Source, factor: float) -> float:
    """Factor of a source without a unit: that of the columns, or 1 for a constant, which is in metres."""
    return 1.0 if source.constant is not None and source.column not in log.values else factor


def _velocities(
    sources: dict[str, Source], raw: dict[str, np.ndarray], differences: np.ndarray, notes: list[str]
) -> np.ndarray:
    """Velocities (m, 3) [m/s] of the log; where no unit is stated, that which suits the positions' differences."""
    zero = np.zeros(len(differences))
    given = np.stack([raw.get(name, zero) for name in VELOCITY], axis=1)
    factors = [sources[name].factor for name in VELOCITY if name in sources]
    if all(factor is not None for factor in factors):
        return given * np.array([sources[name].factor if name in sources else 1.0 for name in VELOCITY])
    fast = np.linalg.norm(differences, axis=1), np.linalg.norm(given, axis=1)
    ratio = float(np.quantile(fast[0], 0.9) / max(np.quantile(fast[1], 0.9), 1e-12))
    unit = min(_SPEEDS, key=lambda one: abs(np.log(_SPEEDS[one] / max(ratio, 1e-12))))
    if not 1 / _NEAR < ratio / _SPEEDS[unit] < _NEAR:
        notes.append("velocities of the log do not suit its positions; differences of positions are taken")
        return differences
    if unit != "m/s":
        notes.append(f"velocities taken for {unit}: state it as vx={sources['vx'].column}[{unit}]")
    return given * _SPEEDS[unit]


def _orientations(log: Columns, sources: dict[str, Source], raw: dict[str, np.ndarray], rows: int) -> np.ndarray:
    if all(name in raw for name in QUATERNION):
        q = np.stack([raw[name] for name in QUATERNION], axis=1)
        norms = np.linalg.norm(q, axis=1)
        wrong = np.nonzero(np.abs(norms - 1) > _NORM)[0]
        if len(wrong):
            found = f"{counted(len(wrong), 'quaternion')} of norm {norms[wrong[0]]:.4g} and others"
            raise InputError(log.path, value=found, allowed="qw, qx, qy, qz of norm 1")
        return q / norms[:, None]
    if "yaw" in raw:
        half = 0.5 * raw["yaw"] * (sources["yaw"].factor or 1.0)
        return np.stack([np.cos(half), 0 * half, 0 * half, np.sin(half)], axis=1)
    return np.tile([1.0, 0.0, 0.0, 0.0], (rows, 1))
