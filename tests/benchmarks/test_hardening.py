# SPDX-License-Identifier: MIT
"""A slice of the attack on the readers; `python -m benchmarks.hardening` runs it at full size."""

import json
import os
import shutil

import numpy as np
import pytest

from benchmarks.hardening import readers
from benchmarks.hardening.mutations import mutate
from benchmarks.hardening.parts import PARTS, part

# Readers whose samples are made in no time; the others run at full size.
QUICK = [
    "colmap, text",
    "mesh, obj",
    "mesh, glb",
    "surfels",
    "fit results",
    "identify checkpoint",
    "train checkpoint",
    "evaluated episode",
    "cell",
    "history",
    "draws",
    "policy",
    "bundle",
]


def test_damaged_files_are_refused_in_one_line_and_soon(tmp_path):
    found = readers.run(tmp_path, 10 * len(QUICK), seed=3, readers=QUICK)
    assert found["violations"] == []
    assert found["number"] == 10 * len(QUICK)
    assert all(one["refused"] > 0 for one in found["readers"].values())
    rows = part("readers").table(found).splitlines()
    assert len(rows) == len(QUICK) + 3
    assert rows[-1].startswith(f"| all | {found['number']} |")
    # What is done is not done again.
    assert readers.run(tmp_path, 10 * len(QUICK), seed=3, readers=QUICK) == found


def test_every_part_has_its_functions():
    assert all(callable(part(name).run) and callable(part(name).table) for name in PARTS)


def test_the_same_seed_makes_the_same_damage(tmp_path):
    sample = tmp_path / "sample"
    sample.mkdir()
    (sample / "a.json").write_text(json.dumps({"a": [1, 2.5, "x"], "b": {"c": None}}))
    (sample / "a.csv").write_text("t,x\n0,1\n1,2\n")
    np.savez(sample / "a.npz", about=np.array('{"a": 1}'), b=np.arange(6.0))
    damaged = set()
    for number in range(60):
        told = []
        for name in ("one", "two"):
            shutil.copytree(sample, tmp_path / name)
            told.append((mutate(tmp_path / name, np.random.default_rng(number)), contents(tmp_path / name)))
            shutil.rmtree(tmp_path / name)
        assert told[0] == told[1]
        damaged.add(told[0])
    assert len(damaged) > 40


def contents(folder):
    """Names of the files of a folder, and a hash of what is in those that are small."""
    found = []
    for path in sorted(folder.rglob("*")):
        small = path.is_file() and not path.is_symlink() and path.stat().st_size < 1 << 20
        found.append((path.name, os.path.islink(path), path.read_bytes() if small and path.suffix != ".npz" else b""))
    return tuple(found)


@pytest.mark.parametrize("how", ["hang", "end", "memory", "message", "file"])
def test_what_goes_wrong_is_seen(tmp_path, monkeypatch, how):
    monkeypatch.setenv("HARDENING_TRIED", how)
    monkeypatch.setattr(readers, "LONGEST", 1.0)
    monkeypatch.setattr(readers, "CHILD", "tests.benchmarks.bad_reader")
    found = readers.run(tmp_path, 2, seed=0, readers=["bad"])
    words = {
        "hang": "no answer in time",
        "end": "the process ended with",
        "memory": "memory of",
        "message": "message of",
        "file": "open",
    }
    assert [words[how] in one["wrong"] for one in found["violations"]] == [True, True]
