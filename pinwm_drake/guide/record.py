# SPDX-License-Identifier: MIT
"""Record of a lab's guide: which inputs each stage was finished with, as SHA-256, and what it said."""

import hashlib
import json
from collections.abc import Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from pinwm_drake.documents import read_json
from pinwm_drake.errors import InputError
from pinwm_drake.files import replacing

RECORD_FILE = "guide.json"
_VERSION = 1
Given = Path | tuple[str, object]
"""Input of a stage: a file, or a name and plain data."""


@dataclass(frozen=True)
class Entry:
    """A stage as it was run last.

    Attributes:
        inputs: Size [bytes], time of change [ns] and SHA-256 of each input; size and time of data are 0.
        notes: Lines that it said.
        error: Why it failed; "" where it did not.
        seconds: s that it took.
    """

    inputs: dict[str, tuple[int, int, str]]
    notes: tuple[str, ...] = ()
    error: str = ""
    seconds: float = 0.0


@dataclass
class Record:
    """Entries of the stages of a lab's folder."""

    folder: Path
    entries: dict[str, Entry] = field(default_factory=dict)

    @staticmethod
    def read(folder: Path) -> "Record":
        """Record of a folder; an empty one where there is none.

        Raises:
            InputError: The file is no record.
        """
        path = folder / RECORD_FILE
        if not path.is_file():
            return Record(folder)
        value = read_json(path).value
        try:
            if value["schema_version"] != _VERSION:
                raise ValueError
            return Record(folder, {key: _entry(one) for key, one in value["stages"].items()})
        except (AttributeError, KeyError, TypeError, ValueError):
            allowed = "a record of pinwm lab; without the file all stages are looked at anew"
            raise InputError(path, value="another document", allowed=allowed) from None

    def put(self, key: str, entry: Entry) -> None:
        """Put an entry in, and write the record."""
        self.entries[key] = entry
        stages = {
            name: {"inputs": one.inputs, "notes": one.notes, "error": one.error, "seconds": round(one.seconds, 1)}
            for name, one in self.entries.items()
        }
        with replacing(self.folder / RECORD_FILE) as temporary:
            text = json.dumps({"schema_version": _VERSION, "stages": stages}, indent=1)
            temporary.write_text(text + "\n", encoding="utf-8")

    def fingerprint(self, key: str, inputs: Sequence[Given]) -> dict[str, tuple[int, int, str]]:
        """Size, time and SHA-256 of inputs; a file of the size and time of the stage's last run is not read again."""
        known = self.entries[key].inputs if key in self.entries else {}
        found = {}
        for given in inputs:
            if isinstance(given, tuple):
                text = json.dumps(given[1], sort_keys=True, default=str)
                found[given[0]] = 0, 0, hashlib.sha256(text.encode()).hexdigest()
                continue
            inside = given.is_relative_to(self.folder)
            name = (given.relative_to(self.folder) if inside else given.absolute()).as_posix()
            about = given.stat()
            size, time = about.st_size, about.st_mtime_ns
            before = known.get(name)
            if before is not None and before[:2] == (size, time):
                found[name] = before
                continue
            with given.open("rb") as file:
                found[name] = size, time, hashlib.file_digest(file, "sha256").hexdigest()
        return found

    def changed(self, key: str, inputs: dict[str, tuple[int, int, str]]) -> list[str]:
        """Names of inputs that are new, gone or of another SHA-256 since the stage's last run."""
        before, now = ({name: one[2] for name, one in some.items()} for some in (self.entries[key].inputs, inputs))
        return sorted(name for name in before.keys() | now.keys() if before.get(name) != now.get(name))


def _entry(value: dict[str, Any]) -> Entry:
    inputs = {str(name): (int(size), int(time), str(sha)) for name, (size, time, sha) in value["inputs"].items()}
    return Entry(inputs, tuple(map(str, value["notes"])), str(value["error"]), float(value["seconds"]))
