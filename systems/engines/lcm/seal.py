# SPDX-License-Identifier: MIT
"""Signatures of LCM messages by a key that controller and driver share.

A signed message is the message and `TRAILER` bytes:

    message | run of the driver (16) | number (8, big-endian) | HMAC-SHA256 (32)

The HMAC is of the channel's name, a zero byte, and all that stands before it. A driver draws its run when it starts,
and shows it in its states. Numbers of a channel only go up, whoever sends: they are nanoseconds of the host's clock.
"""

import hmac
import os
import secrets
import stat
import time
from pathlib import Path

from pinwm_drake.errors import InputError
from pinwm_drake.reading.contents import opened
from pinwm_drake.systems.scenario.schema import LcmLink

_RUN, _NUMBER, _TAG = 16, 8, 32  # bytes
TRAILER = _RUN + _NUMBER + _TAG  # bytes
LEAST_KEY, _MOST_KEY = 32, 4096  # bytes
NOT_SIGNED, OTHER_RUN, REPLAYED = "not signed with the key", "of another run of the driver", "replayed or out of order"


def read_key(path: Path) -> bytes:
    """Return the key of a file: all of its bytes.

    Raises:
        InputError: It is no regular file, others than its owner may use it, the owner is somebody else, or it has
            fewer than 32 bytes.
    """
    with opened(path, _MOST_KEY) as file:
        about = os.fstat(file.fileno())
        mode = stat.S_IMODE(about.st_mode)
        if mode & ~(stat.S_IRUSR | stat.S_IWUSR):
            raise InputError(path, value=f"mode {mode:04o}", allowed=f"0600, as by chmod 600 {path}")
        if about.st_uid not in (os.geteuid(), 0):
            raise InputError(path, value=f"owner {about.st_uid}", allowed=f"{os.geteuid()}, who runs this, or root")
        key = file.read(_MOST_KEY)
    if len(key) < LEAST_KEY:
        raise InputError(path, value=f"{len(key)} bytes", allowed=f"{LEAST_KEY} random bytes or more")
    return key


def seal_of(link: LcmLink, *, driver: bool = False) -> "Seal | None":
    """Return the seal of one end of a link; None where the link has no key.

    Args:
        link: The link.
        driver: Flag: it is the driver's end, which draws its run.

    Raises:
        InputError: The key cannot be used.
    """
    if link.key_file is None:
        return None
    return Seal(read_key(Path(link.key_file)), secrets.token_bytes(_RUN) if driver else None)


class Seal:
    """Seal of one end: it signs what this end sends, and verifies what the other one signed.

    Args:
        key: Key that both ends share.
        run: Run of the driver, 16 bytes; None for a controller, which takes it from the driver's states.
    """

    def __init__(self, key: bytes, run: bytes | None = None) -> None:
        self._key, self._run, self._sent = key, run, 0
        self._heard: dict[str, int] = {}

    def sign(self, channel: str, message: bytes) -> bytes:
        """Return a message of a channel with its signature."""
        self._sent = max(self._sent + 1, time.time_ns())
        body = message + (self._run or bytes(_RUN)) + self._sent.to_bytes(_NUMBER, "big")
        return body + self._tag(channel, body)

    def verify(self, channel: str, signed: bytes, *, adopt: bool = False) -> tuple[bytes, str]:
        """Return the message that was signed, and why it is not to be used; empty where it is.

        Args:
            channel: Name of the channel that it came by.
            signed: The bytes that came.
            adopt: Flag: the run of this message is taken for that of the driver, whatever it was before.
        """
        body, tag = signed[:-_TAG], signed[-_TAG:]
        if len(signed) < TRAILER or not hmac.compare_digest(tag, self._tag(channel, body)):
            return b"", NOT_SIGNED
        run, number = body[-_NUMBER - _RUN : -_NUMBER], int.from_bytes(body[-_NUMBER:], "big")
        if run != self._run:
            if not adopt:
                return b"", OTHER_RUN
            self._run, self._heard = run, {}
        if number <= self._heard.get(channel, -1):
            return b"", REPLAYED
        self._heard[channel] = number
        return body[: -_NUMBER - _RUN], ""

    def _tag(self, channel: str, body: bytes) -> bytes:
        return hmac.digest(self._key, channel.encode() + b"\0" + body, "sha256")
