"""Times at which messages were sent, on the clock of their receiver."""

import math
from dataclasses import dataclass

_MICRO = 1e-6  # s


@dataclass(frozen=True)
class Heard:
    """Record of the last new message of a channel.

    The sender's clock is another one. Of all messages, the one that took least time tells how far the clocks are
    apart, and its own way counts as none: what is known of a time is hence right up to the shortest delay, and a
    message that was held up shows as old.

    Attributes:
        stamp: Time on the sender's clock, s; NaN before the first message.
        arrival: Time on the hearer's clock, s.
        offset: Offset from the sender's clock to the hearer's, s: the least difference so far.
    """

    stamp: float = math.nan
    arrival: float = -math.inf
    offset: float = math.inf

    @property
    def time(self) -> float:
        """Time at which it was sent, s, on the hearer's clock; -inf before the first message."""
        return -math.inf if math.isnan(self.stamp) else self.stamp + self.offset

    def hear(self, microseconds: int, now: float, timeout: float) -> "Heard":
        """Record after a message is there at `now`.

        A message is new if its stamp is later than the last. A stamp that goes back is that of a message which was
        overtaken, and says nothing; or, after a silence of more than `timeout`, of a sender that began again.

        Args:
            microseconds: Stamp of the message.
            now: Time on the hearer's clock, s.
            timeout: Silence after which the sender may have begun again, s.

        Returns:
            This very object, if the message is not new.
        """
        stamp = _MICRO * microseconds
        if stamp == self.stamp:
            return self
        if stamp < self.stamp:
            return Heard(stamp, now, now - stamp) if now - self.arrival > timeout else self
        return Heard(stamp, now, min(self.offset, now - stamp))
