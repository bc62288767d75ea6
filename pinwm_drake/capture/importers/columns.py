# SPDX-License-Identifier: MIT
"""Map from the columns of a log to the motion of the pusher, with units that are stated or guessed aloud.

    t=stamp[ms],px=x[mm],py=-y[mm],pz=0.05[m],yaw=heading[deg],vx=speed_x[mm/s],fx=force_x[N]

On the left stands a name of the capture, on the right a column, its unit in brackets, or a constant.
"""

import re
from dataclasses import dataclass, replace

import numpy as np

from pinwm_drake.capture.episode_tables import FORCE, POSITION, QUATERNION, VELOCITY, PusherTrajectory, quote
from pinwm_drake.capture.importers.film import Columns, counted, in_order, time_unit
from pinwm_drake.capture.scene import FARTHEST
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
    """Return the given sources and those that names of columns tell, with notes that say what was guessed.

    Raises:
        InputError: A header has a unit that is unknown.
    """
    found, notes = dict(given), list[str]()
    if not given:
        plain: dict[str, str] = {}
        for column in log.values:
            match = _NAMED_UNIT.fullmatch(column)
            plain.setdefault((match[1] if match else column).strip().lower(), column)
        for name, others in _OFTEN.items():
            columns = [plain[other] for other in others if other in plain]
            if columns:
                found[name] = Source(columns[0], None)
        words = ",".join(f"{name}={one.column}" for name, one in found.items() if name != one.column)
        notes = [f"columns guessed: {words}"] if words else []
    if log.time and "t" not in given:
        found["t"] = Source(log.time, 1.0)
    return {name: source if source.factor else _of_header(log, name, source) for name, source in found.items()}, notes


def _of_header(log: Columns, name: str, source: Source) -> Source:
    """Source with the unit that its column's header, or the format of the log, says."""
    if source.column not in log.values:
        return source
    if (match := _NAMED_UNIT.fullmatch(source.column)) is None:
        return replace(source, factor=1.0) if log.si else source
    if match[2] not in _UNITS[name]:
        allowed = f"{', '.join(_UNITS[name])}; or --columns with {name}=COLUMN[UNIT]"
        raise InputError(log.path, value=f"column {quote(source.column)} for {name}", allowed=allowed)
    return replace(source, factor=_UNITS[name][match[2]])


def make_trajectory(log: Columns, given: dict[str, Source]) -> tuple[PusherTrajectory, list[str]]:
    """Motion of the pusher from a log, by the clock of the log; velocities by differences where it has none.

    Args:
        log: The log.
        given: Sources by name; empty to guess them by the names of columns.

    Returns:
        The motion, and notes on what was guessed, dropped and missing.

    Raises:
        InputError: A column is missing, a unit cannot be told, a force is no number, or too few rows are left.
    """
    sources, notes = guessed_columns(log, given)
    notes = [*log.notes, *notes]
    for name in ("t", *POSITION[:2]):
        if name not in sources:
            allowed = f"--columns with {name}=COLUMN[UNIT]; the log has {', '.join(list(log.values)[:12])}"
            raise InputError(log.path, value=f"no column for {name}", allowed=allowed)
    if "pz" not in sources:
        raise InputError(log.path, value="no column for pz", allowed="--columns with pz=COLUMN[UNIT] or pz=HEIGHT[m]")
    _require_whole(log, sources)
    raw = {name: _column(log, name, source) for name, source in sources.items()}
    rows = _usable(log, sources, raw, notes)
    t = raw["t"][rows]
    t *= _time_factor(log, sources["t"], t, notes)
    kept, told = in_order(log.path, t, "row")
    notes += told
    t, rows = t[kept], rows[kept]
    raw = {name: values[rows] for name, values in raw.items()}
    p_WP = _positions(log, sources, raw, rows, notes)
    v_WP = np.zeros_like(p_WP)
    v_WP[:-1] = np.diff(p_WP, axis=0) / np.diff(t)[:, None]
    if "vx" in raw:
        v_WP = _velocities(log, sources, raw, v_WP, notes)
    force_W = _forces(log, sources, raw, rows, notes) if "fx" in raw else None
    return PusherTrajectory(t, p_WP, _orientations(log, sources, raw, rows), v_WP, force_W), notes


def _require_whole(log: Columns, sources: dict[str, Source]) -> None:
    """Require vectors and rotations with all of their parts, and one rotation."""
    for names, needed, more in (
        (QUATERNION, QUATERNION, "yaw, or no rotation"),
        (VELOCITY, VELOCITY[:2], "no velocity"),
        (FORCE, FORCE, "no force"),
    ):
        found = [name for name in names if name in sources]
        if found and not all(name in found for name in needed):
            value = f"only {' and '.join(f'{name}={sources[name].column}' for name in found)}"
            raise InputError(log.path, value=value, allowed=f"{', '.join(needed)}; {more}; see --columns")
    if "yaw" in sources and QUATERNION[0] in sources:
        raise InputError(log.path, value="yaw and qw, qx, qy, qz", allowed="one of them; see --columns")


def _usable(log: Columns, sources: dict[str, Source], raw: dict[str, np.ndarray], notes: list[str]) -> np.ndarray:
    """Numbers of the rows with a number in each column but those of forces."""
    usable, first = np.ones(len(log.rows), bool), ""
    for name in [name for name in raw if name not in FORCE]:
        bad = np.nonzero(~np.isfinite(raw[name]))[0]
        if len(bad):
            first = f"row {log.rows[bad[0]]}: {log.told(sources[name].column, int(bad[0]))}"
            notes.append(f"{counted(len(bad), 'row')} without a number for {name} dropped, the first {first}")
            usable[bad] = False
    if usable.sum() < 2 and first:
        found = f"{counted(int(usable.sum()), 'row')} of {len(usable)} with numbers; {first}"
        raise InputError(log.path, value=found, allowed="two or more with finite numbers")
    return np.nonzero(usable)[0]


def _column(log: Columns, name: str, source: Source) -> np.ndarray:
    if source.constant is not None and source.column not in log.values:  # 1, 2, 3 are columns without a header
        return np.full(len(log.rows), source.sign * source.constant)
    if source.column not in log.values:
        allowed = f"a column of the log: {', '.join(list(log.values)[:12])}"
        raise InputError(log.path, value=f"no column {quote(source.column)} for {name}", allowed=allowed)
    return source.sign * log.values[source.column]


def _taken(log: Columns, sources: dict[str, Source], names: list[str], unit: str, why: str = "") -> list[str]:
    """Note that names of columns without a unit are taken for one; none where all of them are constants."""
    names = [name for name in names if sources[name].column in log.values]
    state = f"state it as {names[0]}={sources[names[0]].column}[{unit}]" if names else ""
    return [f"{', '.join(names)} taken for {unit}{why}: {state}"] if names else []


def _time_factor(log: Columns, source: Source, values: np.ndarray, notes: list[str]) -> float:
    if source.factor is not None:
        return source.factor
    unit, factor = time_unit(log.path, values)
    if unit != "s":
        notes += _taken(log, {"t": source}, ["t"], unit)
    return factor


def _positions(
    log: Columns, sources: dict[str, Source], raw: dict[str, np.ndarray], rows: np.ndarray, notes: list[str]
) -> np.ndarray:
    """Positions (m, 3) [m]; InputError where one is farther than any in a capture."""
    for name in POSITION:
        far = np.flatnonzero(np.abs(raw[name]) * (sources[name].factor or 1e-3) > FARTHEST)
        if len(far):
            k, column = int(rows[far[0]]), sources[name].column
            found = log.told(column, k) if column in log.values else f"{name}={column}"
            allowed = f"a place within {FARTHEST:g} m; see the units of --columns"
            raise InputError(log.path, row=int(log.rows[k]), value=found, allowed=allowed)
    guess = [name for name in POSITION if sources[name].factor is None]
    factor = 1.0
    if guess:
        way = float(np.linalg.norm([np.ptp(raw[name]) for name in guess]))
        factor = 1.0 if way <= _LONGEST_WAY else 1e-3
        if factor < 1:
            notes += _taken(log, sources, guess, "mm", f" (a way of {way:.4g})")
    return np.stack(
        [raw[name] * (sources[name].factor or _constant(log, sources[name], factor)) for name in POSITION], axis=1
    )


def _constant(log: Columns, source: Source, factor: float) -> float:
    """Factor of a source without a unit: that of the columns, or 1 for a constant, which is in metres."""
    return 1.0 if source.constant is not None and source.column not in log.values else factor


def _velocities(
    log: Columns,
    sources: dict[str, Source],
    raw: dict[str, np.ndarray],
    differences: np.ndarray,
    notes: list[str],
) -> np.ndarray:
    """Velocities (m, 3) [m/s] of the log; where no unit is stated, that which suits the positions' differences."""
    names = [name for name in VELOCITY if name in raw]
    given = differences.copy()
    for name in names:
        given[:, VELOCITY.index(name)] = raw[name] * (sources[name].factor or 1.0)
    if "vz" not in raw and differences[:, 2].any():
        notes.append("no column for vz; differences of positions are taken")
    guess = [name for name in names if sources[name].factor is None]
    if not guess:
        return given
    at = [VELOCITY.index(name) for name in guess]
    fast = np.linalg.norm(differences[:, at], axis=1), np.linalg.norm(given[:, at], axis=1)
    ratio = float(np.quantile(fast[0], 0.9) / max(np.quantile(fast[1], 0.9), 1e-12))
    unit = min(_SPEEDS, key=lambda one: abs(np.log(_SPEEDS[one] / max(ratio, 1e-12))))
    if not 1 / _NEAR < ratio / _SPEEDS[unit] < _NEAR:
        notes.append("velocities of the log do not suit its positions; differences of positions are taken")
        return differences
    if unit != "m/s":
        notes += _taken(log, sources, guess, unit)
    given[:, at] *= _SPEEDS[unit]
    return given


def _forces(
    log: Columns, sources: dict[str, Source], raw: dict[str, np.ndarray], rows: np.ndarray, notes: list[str]
) -> np.ndarray:
    """Forces (m, 3) [N]; InputError where one is no number, as 0 N would be another force."""
    force_W = np.stack([raw[name] * (sources[name].factor or 1.0) for name in FORCE], axis=1)
    bad = np.argwhere(~np.isfinite(force_W))
    if len(bad):
        k, name = int(rows[bad[0, 0]]), FORCE[bad[0, 1]]
        allowed = "a finite number in each row, or --columns without fx, fy, fz"
        raise InputError(log.path, row=int(log.rows[k]), value=log.told(sources[name].column, k), allowed=allowed)
    notes += _taken(log, sources, [name for name in FORCE if sources[name].factor is None], "N")
    return force_W


def _orientations(log: Columns, sources: dict[str, Source], raw: dict[str, np.ndarray], rows: np.ndarray) -> np.ndarray:
    if "qw" in raw:
        q = np.stack([raw[name] for name in QUATERNION], axis=1)
        norms = np.linalg.norm(q, axis=1)
        wrong = np.nonzero(~(np.abs(norms - 1) <= _NORM))[0]
        if len(wrong):
            found = f"{counted(len(wrong), 'quaternion')} of norm {norms[wrong[0]]:.4g} and others"
            allowed = "qw, qx, qy, qz of norm 1"
            raise InputError(log.path, row=int(log.rows[rows[wrong[0]]]), value=found, allowed=allowed)
        return q / norms[:, None]
    if "yaw" in raw:
        source = sources["yaw"]
        if source.factor is None and raw["yaw"].any():  # 0 is 0 in any unit
            k = int(np.flatnonzero(raw["yaw"])[0])
            found = log.told(source.column, int(rows[k])) if source.column in log.values else f"yaw={source.column}"
            allowed = f"a unit: --columns with yaw={source.column}[rad] or yaw={source.column}[deg]"
            raise InputError(log.path, row=int(log.rows[rows[k]]), value=f"{found} without one", allowed=allowed)
        half = 0.5 * raw["yaw"] * (source.factor or 1.0)
        return np.stack([np.cos(half), 0 * half, 0 * half, np.sin(half)], axis=1)
    return np.tile([1.0, 0.0, 0.0, 0.0], (len(rows), 1))
