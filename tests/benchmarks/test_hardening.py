# SPDX-License-Identifier: MIT
"""A slice of the attack on the readers; `python -m benchmarks.hardening` runs it at full size."""

import gc
import json
import mmap
import os
import shutil
import time

import numpy as np
import pytest
import torch

from benchmarks.hardening import agreement, endurance, kills, messages, readers
from benchmarks.hardening.mutations import mutate
from benchmarks.hardening.parts import PARTS, part
from benchmarks.hardening.values import summary
from pinwm_drake.spatial.poses import Pose

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


def test_damaged_files_are_refused_in_one_line_and_soon(tmp_path, monkeypatch):
    monkeypatch.setenv("HARDENING_TRIED", "message")
    monkeypatch.setattr(readers, "CHILD", "tests.benchmarks.bad_reader")
    names, each = [*QUICK, "bad"], 5
    found = readers.run(tmp_path, each * len(names), seed=3, readers=names)
    assert found["number"] == each * len(names)
    assert [one["reader"] for one in found["violations"]] == each * ["bad"]
    assert all("message of" in one["wrong"] for one in found["violations"])
    assert all(one["refused"] > 0 for name, one in found["readers"].items() if name != "bad")
    rows = part("readers").table(found).splitlines()
    assert len(rows) == len(names) + 3
    assert rows[-1].startswith(f"| all | {found['number']} |")
    # What is done is not done again.
    assert readers.run(tmp_path, each * len(names), seed=3, readers=names) == found


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


@pytest.mark.nightly
@pytest.mark.parametrize("how", ["hang", "end", "memory", "file"])
def test_what_goes_wrong_is_seen(tmp_path, monkeypatch, how):
    monkeypatch.setenv("HARDENING_TRIED", how)
    monkeypatch.setattr(readers, "LONGEST", 1.0 if how == "hang" else readers.LONGEST)
    monkeypatch.setattr(readers, "CHILD", "tests.benchmarks.bad_reader")
    found = readers.run(tmp_path, 2, seed=0, readers=["bad"])
    words = {
        "hang": "no answer in time",
        "end": "the process ended with",
        "memory": "memory of",
        "file": "open",
    }
    assert [words[how] in one["wrong"] for one in found["violations"]] == [True, True]


def test_damaged_messages_end_a_controller_only_latched(tmp_path):
    found = messages.run(tmp_path, 200, seed=5)
    assert found["violations"] == []
    assert found["number"] >= 200
    kinds = found["kinds"]
    assert set(kinds) == {
        f"{kind}, {how}" for kind in ("command", "image", "state", "status") for how in ("without", "with a key")
    }
    for name, one in kinds.items():
        assert one["sent"] == one["kept"] + one["latched"] > 0
        assert (one["latched"] > 0) == name.endswith("without")
    assert 0 < sum(found["reasons"].values()) <= sum(one["latched"] for one in kinds.values())
    assert f"| all | {found['number']} |" in part("messages").table(found)
    # What is done is not done again.
    assert messages.run(tmp_path, 200, seed=5) == found


@pytest.mark.parametrize(
    ("target", "fault", "words"),
    [
        ("pinwm_drake.control.safety_filter.SafetyFilter.watch", lambda self, safety, fault: safety, "sends"),
        ("pinwm_drake.systems.engines.lcm.seal.Seal.verify", lambda self, _, raw, **__: (raw[:-56], ""), "an effect"),
    ],
)
def test_what_goes_wrong_with_messages_is_seen(tmp_path, monkeypatch, target, fault, words):
    monkeypatch.setattr(target, fault)
    found = messages.run(tmp_path, 16, seed=5)
    assert any(words in one["wrong"] for one in found["violations"])


@pytest.mark.parametrize(
    ("memory", "threads", "files", "words"),
    [
        (0.0, 0, 0, ""),
        (7.0, 0, 0, ""),  # 7 MB over the whole run, of which three quarters count
        (20.0, 0, 0, "memory grew by 15."),
        (0.0, 1, 0, "threads grew by 1"),
        (0.0, 0, 3, "files grew by 3"),
    ],
)
def test_growth_after_the_warm_up_is_seen(memory, threads, files, words):
    noise = np.random.default_rng(0).normal(0.0, 2e5, 60)
    rows = [
        {
            "done": k,
            # 100 MB of warm-up do not count.
            "memory": 2e8 + 1e8 * min(k / 10, 1.0) + memory * 2**20 * k / 59 + noise[k],
            "threads": 4 + threads * (k > 50),
            "files": 9 + files * (k > 50),
        }
        for k in range(60)
    ]
    found = endurance.judged(rows)
    assert found["wrong"].startswith(words)
    assert bool(found["wrong"]) == bool(words)
    assert found["growth"] / 2**20 == pytest.approx(0.75 * memory, abs=0.3)


def test_leaks_of_a_process_are_seen(tmp_path, monkeypatch):
    kept = []

    def leaking(size, seed):
        for number in range(size):
            pages = mmap.mmap(-1, 2**20)  # the allocator could reuse what other tests have freed
            pages.write(b"x" * 2**20)
            kept.append((open(os.devnull), pages))  # noqa: SIM115
            yield number + 1

    monkeypatch.setitem(endurance.WORKS, "leaking", (leaking, 60, ""))
    gc.freeze()  # it is collected sixty times, without what other tests have left
    rows = list(endurance.watch("leaking", 60, 0))
    gc.unfreeze()
    assert [row["done"] for row in rows] == list(range(1, 61))
    wrong = endurance.judged(rows)["wrong"]
    assert wrong.startswith("files grew by 30; memory grew by 4")
    for file, _ in kept:
        file.close()


@pytest.mark.nightly
def test_two_threads_and_libraries_of_another_cpu_agree(tmp_path, monkeypatch):
    variants = {"1 thread": (1, {}), "other": (2, agreement.OLD_LIBRARIES)}
    monkeypatch.setattr(agreement, "VARIANTS", variants)
    quantities = ("motion", "image", "action, onnxruntime", "action, torch")
    found = agreement.run(tmp_path, 1, 0, tuple(variants), quantities)
    assert found["violations"] == []
    assert set(found["variants"]["other"]) == set(quantities)
    # Another difference than none is told.
    monkeypatch.setattr(agreement, "values", lambda *_: {"motion": np.zeros(3)})
    monkeypatch.setattr(agreement, "difference", lambda *_: 2 * max(most for _, most in agreement.TOLERANCES.values()))
    wrong = agreement.run(tmp_path, 1, 0, tuple(variants), ("motion",))["violations"]
    assert [one["quantity"] for one in wrong] == ["motion"]


def test_contents_are_compared_by_all_values():
    one = {"a": np.array([1.0, 2.0]), "b": [Pose(torch.zeros(4), torch.ones(3)), "x"]}
    other = {"a": np.array([1.0, 2.0]), "b": [Pose(torch.zeros(4), torch.tensor([1.0, 1.0, 1.001])), "x"]}
    assert summary(one) == summary(dict(reversed(one.items())))
    assert summary(one)[0] != summary(other)[0]
    assert summary({"a": np.array([np.nan, 1.0]), "b": float("inf")})[1] == 2


def test_times_do_not_make_results_others(tmp_path):
    for name, seconds, value in (("one", 1.0, 2), ("two", 3.0, 2), ("other", 1.0, 3)):
        folder = tmp_path / name
        folder.mkdir()
        (folder / "a.json").write_text(json.dumps({"seconds": seconds, "inner": [{"value": value, "time": name}]}))
        (folder / "a.csv").write_text(f"x,seconds\n{value},{seconds}\n")
        np.savez(folder / "a.npz", x=np.array([value]), seconds=np.array(seconds))
        (folder / "a.ply").write_bytes(bytes([value]))
    one, two, other = (kills.contents(tmp_path / name) for name in ("one", "two", "other"))
    assert kills.differences(one, two) == []
    assert kills.differences(one, other) == ["a.csv", "a.json", "a.npz", "a.ply"]
    assert kills.differences(one, {}) == ["a.csv", "a.json", "a.npz", "a.ply"]


@pytest.mark.parametrize(
    ("keeps", "result", "wrong"),
    [(True, "1", ""), (True, "2", "exit code 1"), (False, "1", "exit code 1")],
)
def test_a_run_may_refuse_to_write_over_what_a_killed_one_has_finished(tmp_path, monkeypatch, keeps, result, wrong):
    def begin(arguments, log):
        (tmp_path / "work/a.json").write_text(result)
        log.write_text("allowed: a new or empty folder")
        return 1

    monkeypatch.setattr(kills, "begin", begin)
    monkeypatch.setattr(kills, "kill", lambda child, after: True)
    monkeypatch.setattr(kills, "finish", lambda child: 1)
    monkeypatch.setenv("TMPDIR", str(tmp_path / "work"))
    (tmp_path / "one.json").write_text(json.dumps({"contents": {"a.json": 1}}))
    command = kills.Command(("one",), resume=(), keeps=keeps)
    found = kills.try_once("one", command, tmp_path, 1.0, np.random.default_rng(0))
    assert found["kills"] > 0
    assert found["wrong"].startswith(wrong)
    assert bool(found["wrong"]) == bool(wrong)


def test_a_killed_fork_and_what_it_leaves_are_seen(tmp_path):
    begun = time.monotonic()
    child = kills.begin(("doctor",), tmp_path / "log")
    assert kills.kill(child, 0.0)
    child = kills.begin(("nonsense",), tmp_path / "log")
    assert not kills.kill(child, 60.0)
    assert time.monotonic() - begun < 60.0
    assert "nonsense" in (tmp_path / "log").read_text()
    (tmp_path / "inner").mkdir()
    left = [tmp_path / ".lock", tmp_path / "inner/.a~b~1~01234567.csv", tmp_path / "inner/pinwm~b~1~01234567"]
    for path in (*left, tmp_path / "inner/a.csv"):
        path.write_text("")
    assert kills.leftovers(tmp_path) == sorted(map(str, left))
