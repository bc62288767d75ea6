# SPDX-License-Identifier: MIT
"""Hearing of a robot: its states, its images, their times on the hearer's clock, and what is wrong; without Drake."""

import math
from dataclasses import dataclass, field, replace

WAITING, LIVE, LATCHED = 0, 1, 2
# Faults of a robot's driver, by the number in its states.
DRIVER_FAULTS = (
    "",
    "commands of two sessions came",
    "an older command came again",
    "an expired command came",
    "a command came that is not six finite numbers",
    "a command faster than allowed came",
    "a joint of the arm was faster than it may be",
)
STATE_SIZE = 10  # p_WP, v_WP, session, sequence, mode, fault
_FARTHEST = 1000.0  # m and m/s
_WINDOW = 5.0  # s; a clock that drifts by 100 ppm gains 1 ms in two of them


@dataclass(frozen=True)
class Least:
    """Least value of the last one to two windows of time.

    Attributes:
        now: Least value of the present window.
        before: Least value of the one before.
        begun: s, when the present window began.
    """

    now: float = math.inf
    before: float = math.inf
    begun: float = -math.inf

    @property
    def value(self) -> float:
        """The least value; infinite without any."""
        return min(self.now, self.before)

    def take(self, value: float, time: float) -> "Least":
        """Return the record with one value more, of a time [s] that does not go back."""
        if time - self.begun < _WINDOW:
            return replace(self, now=min(self.now, value))
        recent = self.now if time - self.begun < 2.0 * _WINDOW else math.inf
        return Least(value, recent, time)


@dataclass(frozen=True)
class Hearing:
    """Record of what was heard of a robot.

    All of the robot's stamps, those of its images too, are of one clock. How far that is from the hearer's is told by
    the state that took least time, as if it had taken none; how long that was at most is told by the least round trip,
    from a command to the state that knows its number, which is a fault where it is too long. Windows of 5 s let the
    clocks drift. Differences are taken on the wall clock, which a simulation may be behind of for a moment.

    Attributes:
        stamp: s, robot's clock: of the last state; NaN before the first.
        arrival: s, hearer's clock: when it came.
        values: Its ten values.
        time: s, hearer's clock: of that stamp, as it was when it came; -inf before the first.
        image_stamp: s, robot's clock: of the last image; NaN before the first.
        image_time: s, hearer's clock: of that stamp, as it was when it came; -inf before the first, or before a state.
        offset: Least difference of a state's arrival, on the wall clock, and its stamp, s.
        round_trip: Least time from a command to a state that knows it, s.
        session: The hearer's own session; 0 while it is not armed.
        since: s, hearer's clock: when that began.
        opened: Flag: the robot has taken commands of that session.
        fault: Fault of clocks, or of the form of a state, in words; empty where there is none. In a session it stays:
            whoever looks less often than states come is to see it.
    """

    stamp: float = math.nan
    arrival: float = -math.inf
    values: tuple[float, ...] = ()
    time: float = -math.inf
    image_stamp: float = math.nan
    image_time: float = -math.inf
    offset: Least = field(default_factory=Least)
    round_trip: Least = field(default_factory=Least)
    session: int = 0
    since: float = -math.inf
    opened: bool = False
    fault: str = ""


def hear_session(heard: Hearing, session: int, now: float) -> Hearing:
    """Record with the hearer's own session, as it is now [s]; in each, the round trip is measured anew."""
    if session == heard.session:
        return heard
    return replace(heard, session=session, since=now, opened=False, round_trip=Least(), fault="")


def hear_state(
    heard: Hearing, stamp: float, values: list[float], now: float, wall: float, period: float, timeout: float
) -> Hearing:
    """Record after a state.

    Args:
        heard: The record before.
        stamp: s, robot's clock.
        values: Values of the state; ten, or they are a fault.
        now: s, hearer's clock.
        wall: s, wall clock.
        period: s, between commands; a command's number is that of its period.
        timeout: s, of a silence after which a robot may have begun anew, while there is no session.

    Returns:
        The record; the same object where the message is not new.
    """
    if stamp == heard.stamp:
        return heard
    if len(values) == STATE_SIZE and not all(map(math.isfinite, values)):
        return replace(heard, stamp=stamp, fault=f"robot's state has {values}; allowed: finite numbers")
    if len(values) != STATE_SIZE:
        return replace(heard, stamp=stamp, fault=f"robot's state has {len(values)} values; allowed: {STATE_SIZE}")
    if (most := max(map(abs, values[:6]))) > _FARTHEST:
        return replace(heard, stamp=stamp, fault=f"robot's state has {most:g}; allowed: {_FARTHEST:g} m or m/s at most")
    if stamp < heard.stamp:
        if heard.session or now - heard.arrival <= timeout:
            return replace(heard, fault=f"robot's clock went back by {heard.stamp - stamp:.3f} s")
        heard = Hearing()
    offset, round_trip = heard.offset.take(wall - stamp, wall), heard.round_trip
    ours = heard.session != 0 and values[6] == heard.session and values[8] == LIVE
    if ours:
        round_trip = round_trip.take(max(now - values[7] * period, 0.0), now)
    return replace(
        heard,
        stamp=stamp,
        arrival=now,
        values=tuple(values),
        time=now - (wall - stamp - offset.value),
        offset=offset,
        round_trip=round_trip,
        opened=heard.opened or ours,
        fault=heard.fault if heard.session else "",
    )


def hear_image(heard: Hearing, stamp: float, now: float, wall: float, slack: float) -> Hearing:
    """Record after an image.

    Args:
        heard: The record before.
        stamp: s, robot's clock: when it was taken.
        now: s, hearer's clock.
        wall: s, wall clock.
        slack: s, by which an image that took less time than any state may seem to be of the future.

    Returns:
        The record; the same object where the image is not new, and its time was known.
    """
    if stamp == heard.image_stamp and math.isfinite(heard.image_time):
        return heard
    age = wall - stamp - heard.offset.value if math.isfinite(heard.offset.value) else math.inf
    return replace(heard, image_stamp=stamp, image_time=now - (max(age, 0.0) if age >= -slack else age))


def link_fault(heard: Hearing, now: float, timeout: float) -> str:
    """Fault of the link to a robot in words; empty where there is none.

    Args:
        heard: The record.
        now: s, hearer's clock.
        timeout: s, in which a robot has to take the first commands of a session, and between two states.
    """
    if heard.fault or not heard.values:
        return heard.fault
    session, mode, number = int(heard.values[6]), int(heard.values[8]), int(heard.values[9])
    if not heard.session:
        return ""
    if math.isfinite(heard.round_trip.value) and heard.round_trip.value > timeout:
        return f"robot answers after {heard.round_trip.value:.3f} s; allowed: {timeout:g} s"
    if mode == LATCHED:
        words = DRIVER_FAULTS[number] if 0 < number < len(DRIVER_FAULTS) else f"fault {number}"
        # One that was there before is ended by the first command of this session.
        return f"robot has stopped: {words}" if heard.opened or now - heard.since > timeout else ""
    if mode == LIVE and session != heard.session and (heard.opened or now - heard.since > timeout):
        return "robot takes the commands of another session"
    if mode == WAITING and heard.opened:
        return "robot has closed the session: it heard no command in time"
    if not heard.opened and now - heard.since > timeout:
        return f"robot takes no commands of this session, {now - heard.since:.3f} s after it began"
    return ""
