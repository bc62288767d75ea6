# SPDX-License-Identifier: MIT
"""Checkpoints of long work: one npz file, without pickles, which appears whole or not at all."""

import hashlib
import json
import os
from collections.abc import Iterable, Mapping
from dataclasses import dataclass, fields
from pathlib import Path
from typing import Any, ClassVar, Protocol, Self, runtime_checkable

import numpy as np

from pinwm_drake.errors import InputError
from pinwm_drake.files import replacing
from pinwm_drake.reading.arrays import read_npz
from pinwm_drake.reading.trees import parse_json

DIGEST = "sha256 of the arrays"  # entry of what a file holds as "about"


@runtime_checkable
class Resumable(Protocol):
    """Work that goes on bit by bit from a state that it gave."""

    def get_state(self) -> dict[str, np.ndarray]:
        """All that changes, copied, as arrays that a checkpoint takes."""

    def set_state(self, arrays: Mapping[str, np.ndarray]) -> None:
        """Put what `get_state` gave back, in an object that was made alike."""


def write_arrays(
    path: Path, about: Mapping[str, object], arrays: Mapping[str, np.ndarray], *, compressed: bool = False
) -> None:
    """Write a checkpoint file, over the earlier one where there is one.

    Args:
        path: File of the checkpoint; its folder exists.
        about: Inputs that the work depends on, as JSON takes them.
        arrays: Arrays to keep, by name; none is called "about".
        compressed: Whether to write less and take longer.

    Raises:
        InputError: It cannot be written; the earlier one stays.
    """
    about = {**about, DIGEST: _digest_of_named(arrays)}
    with replacing(path) as temporary:
        save = np.savez_compressed if compressed else np.savez
        save(temporary, allow_pickle=False, about=np.array(json.dumps(about)), **arrays)


def load_arrays(path: Path, allowed: str, *, told: bool = True) -> tuple[dict[str, np.ndarray], dict[str, Any]]:
    """Arrays of an npz file without pickles, and the JSON that it holds as "about".

    Args:
        path: The file.
        allowed: What was expected, for the message.
        told: Flag: there has to be an "about".

    Raises:
        InputError: It cannot be read, or its arrays are not those that it was written with.
    """
    arrays = read_npz(path, allowed)
    if not told:
        return arrays, {}
    if "about" not in arrays:
        raise InputError(path, value='no array "about"', allowed=allowed)
    about = parse_json(str(arrays.pop("about")), path)
    if not isinstance(about, dict):
        raise InputError(path, value=f"about = {about}", allowed=allowed)
    digest = about.pop(DIGEST, None)  # files of version 0.1 have none
    if digest is not None and digest != (found := _digest_of_named(arrays)):
        raise InputError(path, value=f"arrays with SHA-256 {found[:12]}", allowed=f"{str(digest)[:12]}, as written")
    return arrays, about


def _digest_of_named(arrays: Mapping[str, np.ndarray]) -> str:
    digest = hashlib.sha256()
    for name in sorted(arrays):
        array = np.ascontiguousarray(arrays[name])
        digest.update(f"{name} {array.dtype} {array.shape}".encode())
        digest.update(array.tobytes() if array.dtype.kind == "U" else array.data)
    return digest.hexdigest()


def check_arrays(
    path: Path, arrays: Mapping[str, np.ndarray], wanted: Mapping[str, tuple[str, tuple[int | None, ...]]], work: str
) -> None:
    """Check kinds and shapes of arrays, and that numbers are finite.

    Args:
        path: File of the arrays.
        arrays: The arrays.
        wanted: Letters of the kinds that numpy may have, such as "iu", and shape of each; None for any length.
        work: Name of the work in messages.

    Raises:
        InputError: An array is missing, of another kind or shape, or holds a number that is not finite.
    """
    for name, (kinds, shape) in wanted.items():
        if name not in arrays:
            raise InputError(path, value=f"no array {name}", allowed=f"a checkpoint of `{work}`")
        array = arrays[name]
        fits = len(array.shape) == len(shape) and all(
            length in (None, found) for length, found in zip(shape, array.shape, strict=True)
        )
        if not fits or array.dtype.kind not in kinds:
            words = ", ".join("n" if length is None else str(length) for length in shape)
            value = f"{name} of {array.dtype} {array.shape}"
            raise InputError(path, value=value, allowed=f"numbers ({words}), as the settings of this `{work}` have it")
        if array.dtype.kind == "f" and not np.isfinite(array).all():
            raise InputError(path, value=f"{name} with a number that is not finite", allowed="finite numbers")


def digest_of(arrays: Iterable[np.ndarray]) -> str:
    """SHA-256 of the contents of arrays, one after another, in hexadecimal digits."""
    digest = hashlib.sha256()
    for one in arrays:
        digest.update(np.ascontiguousarray(one).data)
    return digest.hexdigest()


def generator_state(generator: np.random.Generator) -> np.ndarray:
    """Return the state of a generator, () of text, for `set_generator_state`."""
    return np.array(json.dumps(generator.bit_generator.state))


def set_generator_state(generator: np.random.Generator, state: np.ndarray) -> None:
    """Put a generator of the same kind into a state (n,) uint8 that `generator_state` gave."""
    generator.bit_generator.state = parse_json(str(state), Path("state of a generator"))


def read_arrays(
    path: Path, about: Mapping[str, object], work: str, names: Iterable[str] = ()
) -> dict[str, np.ndarray] | None:
    """Read the checkpoint of some work, and refuse that of other work.

    Args:
        path: File of the checkpoint.
        about: Inputs that the work which wants to go on depends on.
        work: Name of the work in messages, such as "fit".
        names: Names of the arrays that it has to hold.

    Returns:
        Its arrays, or None where there is no checkpoint.

    Raises:
        InputError: It cannot be read, or is of other work; the message names what differs.
    """
    if not os.path.lexists(path):  # a link to nothing is refused: work would begin anew in silence
        return None
    arrays, written = load_arrays(path, f"a checkpoint of `{work}`")
    for name, value in about.items():
        if written.get(name) != value:
            raise InputError(
                path,
                value=f"a {work} with {name} = {written.get(name)}",
                allowed=f"one with {name} = {value}; start anew to {work} with other settings",
            )
    for name in names:
        if name not in arrays:
            raise InputError(path, value=f"no array {name}", allowed=f"a checkpoint of `{work}`")
    return arrays


@dataclass(frozen=True, eq=False)
class ArrayFile:
    """Dataclass whose fields are arrays, which are a file on disk.

    Attributes:
        work: Name of the work in messages.
        wanted: Words for what stands in such a file.
    """

    work: ClassVar[str]
    wanted: ClassVar[str]

    def write(self, path: Path, about: Mapping[str, object] | None = None, **more: np.ndarray) -> None:
        """Write the arrays to a file, compressed.

        Args:
            path: The file; its folder exists.
            about: What they depend on, as JSON takes it.
            more: Other arrays to keep with them.

        Raises:
            InputError: It cannot be written.
        """
        arrays = {one.name: getattr(self, one.name) for one in fields(self)}
        write_arrays(path, about or {}, arrays | more, compressed=True)

    @classmethod
    def read(cls, path: Path, about: Mapping[str, object] | None = None) -> Self:
        """Read the arrays that `write` wrote to a file.

        Args:
            path: The file.
            about: What they have to depend on; None for anything.

        Raises:
            InputError: There is no such file, or it cannot be read or used.
        """
        names = [one.name for one in fields(cls)]
        arrays = read_arrays(path, about or {}, cls.work, names)
        if arrays is None:
            raise InputError(path, value="no such file", allowed=cls.wanted)
        return cls(**{name: arrays[name] for name in names})
