# SPDX-License-Identifier: MIT
"""Damaged LCM messages for controller and driver: a controller ends only latched, and sends zeros from then on.

A controller runs in a session with a robot that answers as `ArmDriver` does, by the same gate. In each trial one
message after another is damaged and sent beside the true ones, until something latches. Three of four messages go to
ends with a key: what is not signed is dropped, so that nothing latches, and nothing but what was signed reaches the
arm.
"""

import io
import json
import re
import resource
import secrets
import struct
import tempfile
import time
import zlib
from collections import Counter
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
from drake import lcmt_drake_signal, lcmt_image, lcmt_image_array  # type: ignore[import-untyped]  # LCM's types
from PIL import Image
from pydrake.lcm import DrakeLcm
from pydrake.systems.analysis import Simulator
from pydrake.systems.framework import DiagramBuilder

from pinwm_drake.files import replacing
from pinwm_drake.learning.safety import default_limits
from pinwm_drake.learning.spec import PolicySpec
from pinwm_drake.systems.arm.gate import CommandGate
from pinwm_drake.systems.arm.messages import STATE_NAMES, image_message
from pinwm_drake.systems.control.controller import AddPolicyController
from pinwm_drake.systems.engines.lcm.engine import LcmHandle
from pinwm_drake.systems.engines.lcm.hearing import LATCHED, LIVE
from pinwm_drake.systems.engines.lcm.messages import Tally
from pinwm_drake.systems.engines.lcm.seal import Seal, read_key
from pinwm_drake.systems.engines.lcm.signal import signal_message
from pinwm_drake.systems.envs.options import EnvOptions, environment_setup
from pinwm_drake.systems.envs.policy_scene import policy_spec
from pinwm_drake.systems.scenario.load import load_setup
from pinwm_drake.systems.station.station import make_station

Generator = np.random.Generator
STATE = "messages.json"
MOST_GROWTH = 64 << 20  # bytes of memory, from the first tenth to the end
_KINDS = ("command", "state", "status", "image")
_PERIOD, _SIZE = 0.05, 32  # s, px
_LATE, _AFTER = 2, 4  # periods until both ends have latched, and in which they are watched
_LONGEST_TRIAL = 20  # periods with damaged messages
_SIGNED = 0.75  # share of the messages that go to ends with a key
_KEPT = 50  # violations that are told
_FASTER = 1.0101  # times the largest speed: what the gate allows, and rounding
_NUMBERS = [np.nan, np.inf, -np.inf, 0.0, -0.0, 1.0, -1.0, 0.5, 1e-320, 1e308, -1e308, 2.0**31, 2.0**53, 2.0**63, 1e12]
_INTEGERS = [0, 1, -1, 2, 3, 4, 7, 255, 16384, 16385, 1 << 16, 2**31 - 1, -(2**31)]
_MOMENTS = [0, 1, -1, 10**7, -(10**7), 2**62, -(2**62), 2**63 - 1, -(2**63)]


class Still:
    """Policy that moves to and fro by a centimetre."""

    def __init__(self, spec: PolicySpec) -> None:
        self.spec, self._sign = spec, 1.0

    def act(self, image: np.ndarray, p_WP: np.ndarray) -> np.ndarray:
        """Translation (2,) m."""
        self._sign = -self._sign
        return np.array([0.01 * self._sign, 0.0])


class Rig:
    """A controller and the gate of a driver on one line, with a robot that is said to stand still.

    Args:
        key: File of their key; None without one.
    """

    def __init__(self, key: Path | None) -> None:
        setup = environment_setup(load_setup("push_t"), EnvOptions(image_size=_SIZE))
        link = replace(setup.scenario.lcm, period=_PERIOD, timeout=0.2, key_file=None if key is None else str(key))
        setup = replace(setup, scenario=replace(setup.scenario, lcm=link), period=_PERIOD)
        self.link, self.lcm, self.sent = link, DrakeLcm("memq://"), list[bytes]()
        self.seal = None if key is None else Seal(read_key(key), secrets.token_bytes(16))
        self.lcm.Subscribe(link.command_channel, self.sent.append)
        spec = policy_spec(setup, EnvOptions(frames=2, max_translation=0.02, max_steps=1000), "rgb")
        self.limits = default_limits(spec)
        builder = DiagramBuilder()
        self.station = builder.AddSystem(make_station(setup, "lcm", lcm=self.lcm, armed=True))
        self.controller = AddPolicyController(builder, self.station, Still(spec), self.limits)
        self.gate_tally = Tally()
        gate = CommandGate(self.lcm, link, self.limits.max_speed, self.gate_tally, self.seal)
        self.gate_system = builder.AddSystem(gate)
        self.simulator = Simulator(builder.Build())
        self.context = self.simulator.get_mutable_context()
        self.handle = self.station.engine.handle
        assert isinstance(self.handle, LcmHandle)
        self.p_WP = np.array([0.0, -0.15, setup.scenario.start.pusher_height])
        self.noise, self._step = np.random.default_rng(0), 0
        self.true: dict[str, bytes] = {}

    @property
    def gate(self) -> Any:
        """Present state of the gate."""
        return self.gate_system.gate(self.context)

    @property
    def status(self) -> Any:
        """Status of the controller."""
        return self.controller.status(self.context)

    def begin(self) -> None:
        """Reset and arm the controller, and go on until it moves the robot."""
        self.controller.Reset(self.context)
        for _ in range(20):  # as long as a robot that was silenced takes
            self.go()
            if not self.status.reason and self.gate.mode != LIVE:
                break
        self.controller.Arm(self.context)
        for _ in range(10):
            self.go()
            if self.status.state == "running" and self.gate.mode == LIVE:
                return

    def go(self, *damaged: tuple[str, bytes]) -> list[list[float]]:
        """Send what a robot sends, and after it what is damaged, with its channel; the commands of the period."""
        time = _PERIOD * self._step  # that of the gate
        gate = self.gate
        state = [*self.p_WP, 0.0, 0.0, 0.0, gate.session, gate.sequence, gate.mode, gate.fault]
        self.true["state"] = signal_message(STATE_NAMES, np.array(state, float), time).encode()
        picture = np.full((_SIZE, _SIZE, 4), 255, np.uint8)
        picture[..., 3] = 0
        picture[14:19, 14:19, :3] = self.noise.integers(80, 120, (5, 5, 3))
        picture[14:19, 14:19, 3] = 255
        self.true["image"] = image_message(picture, time).encode()
        for name in ("state", "image") if self._step % 2 else ("state",):
            self._publish(getattr(self.link, f"{name}_channel"), self.true[name])
        for channel, raw in damaged:
            self.lcm.Publish(channel, raw)
        self.lcm.HandleSubscriptions(0)
        self.sent.clear()
        self._step += 1
        self.simulator.AdvanceTo(_PERIOD * self._step)
        self.lcm.HandleSubscriptions(0)
        mine = list(self.sent)
        if mine:
            self.true["command"] = mine[-1] if self.seal is None else mine[-1][:-56]
        return [list(lcmt_drake_signal.decode(raw).val) for raw in mine]

    def _publish(self, channel: str, message: bytes) -> None:
        self.lcm.Publish(channel, message if self.seal is None else self.seal.sign(channel, message))


def damaged(kind: str, true: dict[str, bytes], rng: Generator) -> tuple[bytes, str]:
    """Message of a kind that is damaged, and how."""
    raw = true["state" if kind == "status" else kind]
    pool = _BYTES if rng.random() < 0.3 else _IMAGE if kind == "image" else _SIGNAL
    words = []
    for _ in range(rng.integers(1, 3)):
        change = pool[rng.integers(len(pool))]
        try:
            raw = change(raw, rng, kind)
        except Exception as error:  # the damage before left nothing of the structure
            words.append(f"{change.__name__}: {type(error).__name__}")
            continue
        words.append(change.__name__)
    return raw, f"{kind}: {', '.join(words)}"


def run(out: Path, number: int, seed: int) -> dict[str, Any]:
    """Send `number` damaged messages, three of four to ends with a key; see `parts.Part`."""
    found: dict[str, Any] = {"seed": seed, "done": 0, "signed": 0, "kinds": {}, "reasons": {}}
    found |= {"violations": [], "memory": [0, 0]}
    if (out / STATE).exists():
        found = json.loads((out / STATE).read_text())
        if found["seed"] != seed:
            raise SystemExit(f"{out / STATE}: seed {found['seed']}; allowed: {seed}, or another folder")
    if found["done"] >= number:
        return {**found, "number": found["done"]}
    with tempfile.TemporaryDirectory() as folder:
        key = Path(folder) / "robot.key"
        key.touch(0o600)
        key.write_bytes(secrets.token_bytes(32))
        rigs = {False: Rig(None), True: Rig(key)}
        begun, kept, found["memory"] = found["done"], time.monotonic(), [0, 0]
        trial = 0
        while found["done"] < number:
            signed = found["signed"] < _SIGNED * found["done"]
            found["signed"] -= found["done"] if signed else 0
            _trial(rigs[signed], signed, np.random.default_rng([seed, begun, trial]), found, number)
            found["signed"] += found["done"] if signed else 0
            trial += 1
            if found["done"] - begun >= (number - begun) // 10 and not found["memory"][0]:
                found["memory"][0] = _memory()
            if time.monotonic() - kept > 10.0:
                _keep(out, found)
                kept = time.monotonic()
    found["memory"][1] = _memory()
    if (grown := found["memory"][1] - found["memory"][0]) > MOST_GROWTH:
        _wrong(found, "all", f"memory grew by {grown >> 20} MB")
    _keep(out, found)
    return {**found, "number": found["done"]}


def table(found: dict[str, Any]) -> str:
    """Counts by kind of message."""
    lines = ["| messages | sent | not used or without effect | latched | wrong |", "| --- | --- | --- | --- | --- |"]
    rows = [[name, *(one[key] for key in ("sent", "kept", "latched", "wrong"))] for name, one in _sorted(found)]
    rows.append(["all", *(sum(row[k] for row in rows) for k in range(1, 5))])
    lines += [f"| {' | '.join(map(str, row))} |" for row in rows]
    first, last = (size >> 20 for size in found["memory"])
    return "\n".join([*lines, "", f"Memory: {first} MB after a tenth of the messages, {last} MB at the end."])


def _sorted(found: dict[str, Any]) -> list[tuple[str, dict[str, int]]]:
    return sorted(found["kinds"].items())


def _trial(rig: Rig, signed: bool, rng: Generator, found: dict[str, Any], number: int) -> None:
    """Damage messages until something latches, or as many as a trial has."""
    try:
        rig.begin()
        wrong = f"not running: {rig.status.state}, {rig.status.reason}, gate {rig.gate.mode}"
    except Exception as error:
        wrong = f"{type(error).__name__}: {error}"[:400]
    if rig.status.state != "running" or rig.gate.mode != LIVE:
        _wrong(found, "true messages alone", wrong)
        found["done"] += 1  # or it would never end
        return
    for _ in range(_LONGEST_TRIAL):
        if found["done"] >= number:
            return
        kinds = _KINDS if signed else [_KINDS[rng.integers(len(_KINDS))]]
        drawn = [damaged(kind, rig.true, rng) for kind in kinds]
        how = "; ".join(words for _, words in drawn)
        channels = [getattr(rig.link, f"{'state' if kind == 'status' else kind}_channel") for kind in kinds]
        before = _dropped(rig)
        try:
            wrong = _moving(rig, rig.go(*zip(channels, (raw for raw, _ in drawn), strict=True)), latched=False)
            if not signed:
                wrong = wrong or _moving(rig, rig.go(), latched=False)
            latched = rig.status.state == "latched" or rig.gate.mode == LATCHED
            if signed and not wrong:
                if latched or rig.gate.mode != LIVE:
                    wrong = f"a message without a signature had an effect: {rig.status.reason}, {rig.gate.fault}"
                elif _dropped(rig) != before + len(drawn):
                    wrong = f"{_dropped(rig) - before} messages were counted; allowed: {len(drawn)}"
            if latched and not wrong:
                wrong = _latched(rig, found)
        except Exception as error:
            latched, wrong = True, f"{type(error).__name__}: {error}"[:400]
        found["done"] += len(drawn)
        for kind in kinds:
            name = f"{kind}, {'with a key' if signed else 'without'}"
            one = found["kinds"].setdefault(name, {"sent": 0, "kept": 0, "latched": 0, "wrong": 0})
            one["sent"] += 1
            one["wrong" if wrong else "latched" if latched else "kept"] += 1
        if wrong:
            _wrong(found, how, wrong)
        if latched or wrong or rig.gate.mode != LIVE or rig.status.state != "running":
            return


def _dropped(rig: Rig) -> int:
    return rig.gate_tally.counts.total() + rig.handle.tally.counts.total()


def _latched(rig: Rig, found: dict[str, Any]) -> str:
    """Watch ends of which one has latched; what is wrong with them, or ""."""
    for k in range(_AFTER):
        # A driver that latched says so in its next state, which the controller sees at its next look.
        if wrong := _moving(rig, rig.go(), latched=k >= _LATE):
            return wrong
    if rig.status.state != "latched":
        return f"the controller is {rig.status.state} beside a gate with fault {rig.gate.fault}"
    if any(rig.gate.velocity):
        return f"the gate moves after the controller has latched: {rig.gate.velocity}"
    reasons = Counter(found["reasons"])
    words = re.split(r"[:\[;(]", rig.status.reason)[0].strip()
    reasons[re.sub(r"-?\d[\d.e+]*", "N", words)] += 1
    found["reasons"] = dict(reasons.most_common(60))
    return ""


def _moving(rig: Rig, commands: list[list[float]], *, latched: bool) -> str:
    """What is wrong with commands of a period and with the gate; "" where nothing is."""
    if not commands:
        return "no command was sent"
    speed = _FASTER * rig.limits.max_speed
    for values in [*commands, [*rig.gate.velocity, 1.0, 0.0, 0.0]]:
        if not np.isfinite(values[:3]).all() or np.linalg.norm(values[:3]) > speed:
            return f"a velocity of {values[:3]}"
    if latched and any(any(values[:4]) for values in commands):
        return f"a latched controller sends {commands[-1]}"
    if rig.gate.mode == LATCHED and any(rig.gate.velocity):
        return "a latched gate moves"
    return ""


def _wrong(found: dict[str, Any], how: str, words: str) -> None:
    if len(found["violations"]) < _KEPT:
        found["violations"].append({"how": how, "wrong": words})


def _memory() -> int:
    """Resident memory now, bytes."""
    pages = int(Path("/proc/self/statm").read_text().split()[1])
    return pages * resource.getpagesize()


def _keep(out: Path, found: dict[str, Any]) -> None:
    with replacing(out / STATE) as temporary:
        temporary.write_text(json.dumps(found, indent=1) + "\n")


# Damage: a message's bytes, a generator and its kind in; bytes out.


def cut(raw: bytes, rng: Generator, kind: str) -> bytes:
    """Truncation."""
    return raw[: rng.integers(len(raw) + 1)]


def flip(raw: bytes, rng: Generator, kind: str) -> bytes:
    """A few bits."""
    data = bytearray(raw)
    for at in rng.integers(min(len(data), 200), size=rng.integers(1, 9)):
        data[at] ^= 1 << rng.integers(8)
    return bytes(data)


def overwrite(raw: bytes, rng: Generator, kind: str) -> bytes:
    """A stretch of zeros, ones, the largest integers or noise."""
    length, at = int(rng.integers(1, 65)), int(rng.integers(min(len(raw), 200)))
    fills = [bytes(length), b"\xff" * length, (b"\x7f\xff\xff\xff" * length)[:length], rng.bytes(length)]
    return raw[:at] + fills[rng.integers(len(fills))] + raw[at + length :]


def longer(raw: bytes, rng: Generator, kind: str) -> bytes:
    """More bytes than the message has."""
    return raw + rng.bytes(int(rng.integers(1, 100)))


def announced(raw: bytes, rng: Generator, kind: str) -> bytes:
    """Another size than the data have."""
    at = 8 if kind != "image" else int(rng.choice([24, 28, 32]))
    return raw[:at] + struct.pack(">i", int(rng.choice(_INTEGERS))) + raw[at + 4 :]


def nothing(raw: bytes, rng: Generator, kind: str) -> bytes:
    """No bytes, noise, or far too many."""
    return [b"", rng.bytes(100), bytes(1 << 20), raw * 50][rng.integers(4)]


def other_type(raw: bytes, rng: Generator, kind: str) -> bytes:
    """A message of another type."""
    kinds: list[Any] = [lcmt_drake_signal, lcmt_image_array, lcmt_image]
    return bytes(kinds[rng.integers(3)]().encode())


def _signal(change: Callable[[Any, Generator, str], None]) -> Callable[[bytes, Generator, str], bytes]:
    """Change of a decoded vector, whose size is made to fit."""

    def changed(raw: bytes, rng: Generator, kind: str) -> bytes:
        message = lcmt_drake_signal.decode(raw)
        message.val = list(message.val)
        change(message, rng, kind)
        message.dim = len(message.val)
        message.coord = (list(message.coord) + [""] * message.dim)[: message.dim]
        return bytes(message.encode())

    changed.__name__ = change.__name__
    return changed


@_signal
def value(message: Any, rng: Generator, kind: str) -> None:
    """A value that is none, or another one; of a status, the last four."""
    place = int(rng.integers(6, 10) if kind == "status" else rng.integers(len(message.val)))
    draws = [_NUMBERS[rng.integers(len(_NUMBERS))], float(rng.normal()), float(rng.integers(1 << 48))]
    message.val[place] = draws[rng.integers(3)]


@_signal
def values(message: Any, rng: Generator, kind: str) -> None:
    """All values."""
    message.val = [_NUMBERS[k] for k in rng.integers(len(_NUMBERS), size=len(message.val))]


@_signal
def fewer(message: Any, rng: Generator, kind: str) -> None:
    """Another number of values."""
    message.val = (message.val * 20)[: rng.integers(0, 60)]


@_signal
def moment(message: Any, rng: Generator, kind: str) -> None:
    """Another stamp."""
    message.timestamp = int(_MOMENTS[rng.integers(len(_MOMENTS))])


@_signal
def names(message: Any, rng: Generator, kind: str) -> None:
    """Other names."""
    message.coord = [["", "é🦆", "x" * 5000, "\x1b[2J", "[/a]"][rng.integers(5)]] * len(message.val)


def _image(change: Callable[[Any, Generator], None]) -> Callable[[bytes, Generator, str], bytes]:
    """Change of a decoded image; of a status there is none."""

    def changed(raw: bytes, rng: Generator, kind: str) -> bytes:
        message = lcmt_image_array.decode(raw)
        change(message, rng)
        message.num_images = len(message.images)
        for image in message.images:
            image.data = bytes(image.data)[: max(image.size, 0)].ljust(min(max(image.size, 0), 1 << 20), b"\0")
            image.size = len(image.data)
        return bytes(message.encode())

    changed.__name__ = change.__name__
    return changed


@_image
def header(message: Any, rng: Generator) -> None:
    """A field of the header."""
    names = ("width", "height", "row_stride", "size", "pixel_format", "channel_type", "compression_method")
    image, name = message.images[0], names[rng.integers(len(names))]
    low, high = (-128, 128) if name in names[-3:] else (-(2**31), 2**31)
    draws = [*(k for k in _INTEGERS if low <= k < high), int(rng.integers(low, high))]
    setattr(image, name, int(draws[rng.integers(len(draws))]))


@_image
def exposure(message: Any, rng: Generator) -> None:
    """Another stamp."""
    message.header.utime = int(_MOMENTS[rng.integers(len(_MOMENTS))])


@_image
def images(message: Any, rng: Generator) -> None:
    """No image, or several."""
    message.images = message.images * [0, 2, 3, 20][rng.integers(4)]


@_image
def contents(message: Any, rng: Generator) -> None:
    """Other bytes: bombs, other sizes, noise, PNG with a chunk that is none."""
    image = message.images[0]
    file = io.BytesIO()
    shape = [(_SIZE, _SIZE, 4), (_SIZE, _SIZE, 3), (_SIZE, _SIZE - 1, 4), (600, 600, 4)][rng.integers(4)]
    Image.fromarray(rng.integers(0, 255, shape, np.uint8)).save(file, "PNG")
    png = file.getvalue()
    chunk = b"[/a]" + rng.bytes(8)
    bad = png[:33] + struct.pack(">I", 8) + chunk + struct.pack(">I", zlib.crc32(chunk)) + png[33:]
    text = b"zTXt" + b"a\0\0" + zlib.compress(bytes(3_000_000), 9)
    bomb = png[:33] + struct.pack(">I", len(text) - 4) + text + struct.pack(">I", zlib.crc32(text)) + png[33:]
    huge = png[:16] + struct.pack(">II", 1 << 30, 1 << 30) + png[24:]
    data = [zlib.compress(bytes(3_000_000), 9), zlib.compress(bytes(4 * _SIZE * _SIZE)), rng.bytes(500), png, bad, bomb]
    image.data = [*data, huge][rng.integers(7)]
    image.size = len(image.data)
    image.compression_method = [0, 1, 3, 3][rng.integers(4)]


@_image
def pixels(message: Any, rng: Generator) -> None:
    """Other pixels, in the right form: none, all, noise, or the same again."""
    shape = (_SIZE, _SIZE, 4)
    drawn = [np.zeros(shape, np.uint8), np.full(shape, 255, np.uint8), rng.integers(0, 256, shape, np.uint8)]
    image = message.images[0]
    image.data = zlib.compress(drawn[rng.integers(3)].tobytes(), 1)
    image.size = len(image.data)


_BYTES: list[Callable[[bytes, Generator, str], bytes]] = [cut, flip, overwrite, longer, announced, nothing, other_type]
_SIGNAL: list[Callable[[bytes, Generator, str], bytes]] = [value, value, values, fewer, moment, names]
_IMAGE: list[Callable[[bytes, Generator, str], bytes]] = [header, header, exposure, images, contents, pixels]
