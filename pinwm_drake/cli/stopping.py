# SPDX-License-Identifier: MIT
"""Signals that end a command which moves a robot: at once before it is armed, and between two periods afterwards."""

import os
import signal
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from types import FrameType

WORDS = {signal.SIGINT: "Ctrl-C", signal.SIGTERM: "SIGTERM", signal.SIGHUP: "a closed terminal"}


class Stop:
    """Wish to stop, as signals bring it.

    Until `defer`, a signal ends the process at once: nothing has moved, and an exception could be lost in a library
    that is just being loaded. From then on it is only noted, for the command to end in order.
    """

    def __init__(self) -> None:
        """Begins without a wish, and not deferred."""
        self._signal = 0
        self._deferred = False

    def __call__(self) -> str:
        """Reason to stop in words; empty where there is none."""
        return WORDS.get(signal.Signals(self._signal), "a signal") if self._signal else ""

    @property
    def exit_code(self) -> int:
        """Exit code by the signal, 128 and its number, as shells have it; 0 without one."""
        return 128 + self._signal if self._signal else 0

    def defer(self) -> None:
        """Note signals from now on, in the place of ending at once."""
        self._deferred = True

    def close(self) -> None:
        """Wishes to stop, as the terminal does not take output any more."""
        self._signal = self._signal or int(signal.SIGHUP)

    def take(self, number: int, frame: FrameType | None) -> None:
        """Take a signal, as a handler of Python's `signal`."""
        if not self._deferred:
            words = f"\nstopped by {WORDS[signal.Signals(number)]} before it was armed: nothing was moved\n"
            with suppress(OSError):  # where nobody reads it
                os.write(1, words.encode())
            os._exit(128 + number)
        self._signal = self._signal or number


@contextmanager
def stop_signals() -> Iterator[Stop]:
    """Return the wish to stop by SIGINT, SIGTERM or SIGHUP, whose handlers are its own in between."""
    stop = Stop()
    before = {number: signal.signal(number, stop.take) for number in WORDS}
    try:
        yield stop
    finally:
        for number, handler in before.items():
            signal.signal(number, handler)
