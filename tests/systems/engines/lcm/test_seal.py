# SPDX-License-Identifier: MIT
"""Signed messages: what is let through, and which keys are taken."""

import hashlib
import hmac
import os

import pytest

from pinwm_drake.errors import InputError
from pinwm_drake.systems.engines.lcm import seal
from pinwm_drake.systems.engines.lcm.seal import NOT_SIGNED, OTHER_RUN, REPLAYED, TRAILER, Seal, read_key, seal_of
from pinwm_drake.systems.scenario.schema import LcmLink

KEY, RUN = bytes(range(32)), bytes(range(100, 116))


@pytest.fixture
def ends():
    """Seals of a controller and a driver, which have heard each other."""
    controller, driver = Seal(KEY), Seal(KEY, RUN)
    assert controller.verify("STATE", driver.sign("STATE", b"state"), adopt=True) == (b"state", "")
    return controller, driver


def test_the_signature_is_hmac_sha256_of_channel_message_run_and_number(ends):
    signed = ends[0].sign("COMMAND", b"left")
    assert len(signed) == 4 + TRAILER
    assert signed[:20] == b"left" + RUN
    # By the definition of HMAC itself.
    block = KEY.ljust(64, b"\0")
    inner = hashlib.sha256(bytes(b ^ 0x36 for b in block) + b"COMMAND\0" + signed[:-32]).digest()
    assert signed[-32:] == hashlib.sha256(bytes(b ^ 0x5C for b in block) + inner).digest()
    assert ends[1].verify("COMMAND", signed) == (b"left", "")


def test_no_bit_can_be_changed(ends):
    signed = ends[0].sign("COMMAND", b"left")
    for bit in range(8 * len(signed)):
        forged = bytearray(signed)
        forged[bit // 8] ^= 1 << bit % 8
        assert ends[1].verify("COMMAND", bytes(forged)) == (b"", NOT_SIGNED)
    for short in range(len(signed)):
        assert ends[1].verify("COMMAND", signed[:short]) == (b"", NOT_SIGNED)
    assert ends[1].verify("STATE", signed) == (b"", NOT_SIGNED)
    assert ends[1].verify("COMMAND", Seal(bytes(32), RUN).sign("COMMAND", b"left")) == (b"", NOT_SIGNED)
    assert ends[1].verify("COMMAND", signed) == (b"left", "")


def test_what_comes_again_or_out_of_order_is_dropped(ends):
    controller, driver = ends
    first, second, third = (controller.sign("COMMAND", word) for word in (b"a", b"b", b"c"))
    assert driver.verify("COMMAND", second) == (b"b", "")
    assert [driver.verify("COMMAND", one) for one in (first, second)] == [(b"", REPLAYED)] * 2
    assert driver.verify("COMMAND", third) == (b"c", "")
    # The numbers of the next controller begin after those of this one.
    other = Seal(KEY)
    other.verify("STATE", driver.sign("STATE", b""), adopt=True)
    assert driver.verify("COMMAND", other.sign("COMMAND", b"d")) == (b"d", "")
    assert driver.verify("COMMAND", third) == (b"", REPLAYED)


def test_nothing_of_another_run_of_the_driver_counts(ends):
    controller, driver = ends
    old = controller.sign("COMMAND", b"old")
    again = Seal(KEY, bytes(16))
    assert again.verify("COMMAND", old) == (b"", OTHER_RUN)
    state = again.sign("STATE", b"new")
    assert controller.verify("STATE", state) == (b"", OTHER_RUN)
    assert controller.verify("STATE", state, adopt=True) == (b"new", "")
    assert again.verify("COMMAND", controller.sign("COMMAND", b"go")) == (b"go", "")
    assert controller.verify("STATE", driver.sign("STATE", b"state")) == (b"", OTHER_RUN)


def test_a_controller_that_has_heard_no_driver_moves_none():
    assert Seal(KEY, RUN).verify("COMMAND", Seal(KEY).sign("COMMAND", b"go")) == (b"", OTHER_RUN)


def test_tags_are_compared_in_constant_time(ends, monkeypatch):
    signed, compared = ends[0].sign("COMMAND", b"left"), []
    monkeypatch.setattr(seal.hmac, "compare_digest", lambda *pair: compared.append(pair) or hmac.digest is None)
    assert ends[1].verify("COMMAND", signed) == (b"", NOT_SIGNED)
    assert compared == [(signed[-32:], signed[-32:])]


def test_a_key_is_a_private_file_of_32_bytes(tmp_path):
    path = tmp_path / "robot.key"
    path.write_bytes(KEY)
    path.chmod(0o600)
    assert read_key(path) == KEY
    assert seal_of(LcmLink()) is None
    ours, theirs = (seal_of(LcmLink(key_file=str(path)), driver=driver) for driver in (False, True))
    assert ours.verify("STATE", theirs.sign("STATE", b"x"), adopt=True) == (b"x", "")
    for mode in (0o644, 0o640, 0o604, 0o660, 0o700, 0o4600):
        path.chmod(mode)
        with pytest.raises(InputError, match=rf"robot\.key: got mode {mode:04o}; allowed: 0600, as by chmod 600"):
            read_key(path)
    path.chmod(0o600)
    path.write_bytes(KEY[:31])
    with pytest.raises(InputError, match=r"got 31 bytes; allowed: 32 random bytes or more"):
        read_key(path)
    path.write_bytes(bytes(5000))
    with pytest.raises(InputError, match="4096 bytes at most"):
        read_key(path)


def test_what_is_no_file_is_no_key(tmp_path):
    os.mkfifo(tmp_path / "pipe", 0o600)
    for name, words in (("pipe", "something that is no file"), ("missing", "no such file"), (".", "a folder")):
        with pytest.raises(InputError, match=words):
            read_key(tmp_path / name)
    with pytest.raises(InputError, match="something that is no file"):
        seal_of(LcmLink(key_file="/dev/zero"))


def test_a_key_of_somebody_else_is_refused(tmp_path, monkeypatch):
    path = tmp_path / "robot.key"
    path.write_bytes(KEY)
    path.chmod(0o600)
    if os.geteuid() == 0:
        os.chown(path, 12345, -1)
    else:
        monkeypatch.setattr(seal.os, "geteuid", lambda: 12345)
    with pytest.raises(InputError, match=r"got owner \d+; allowed: \d+, who runs this, or root"):
        read_key(path)
