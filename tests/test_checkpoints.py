# SPDX-License-Identifier: MIT
import json

import numpy as np
import pytest

from pinwm_drake.checkpoints import check_arrays, load_arrays, read_arrays, write_arrays
from pinwm_drake.errors import InputError

ARRAYS = {"a": np.arange(6.0).reshape(2, 3), "n": np.array(3), "text": np.array("é"), "columns": np.ones((2, 3)).T}


def test_arrays_come_back_with_what_they_depend_on(tmp_path):
    write_arrays(tmp_path / "a.npz", {"x": 1}, ARRAYS)
    arrays, about = load_arrays(tmp_path / "a.npz", "a checkpoint")
    assert about == {"x": 1}
    for name, array in ARRAYS.items():
        np.testing.assert_array_equal(arrays[name], array)


@pytest.mark.parametrize(
    "change", [{"a": np.zeros((2, 3))}, {"a": np.arange(6.0)}, {"more": np.array(1)}, {"n": np.array(4)}]
)
def test_arrays_that_were_changed_are_refused(tmp_path, change):
    write_arrays(tmp_path / "a.npz", {"x": 1}, ARRAYS)
    with np.load(tmp_path / "a.npz") as file:
        arrays = {name: file[name] for name in file.files}
    np.savez(tmp_path / "a.npz", **(arrays | change))
    with pytest.raises(InputError, match=r"got arrays with SHA-256 [0-9a-f]{12}; allowed: [0-9a-f]{12}, as written"):
        read_arrays(tmp_path / "a.npz", {"x": 1}, "work")


def test_a_file_of_version_01_without_a_digest_is_read(tmp_path):
    np.savez(tmp_path / "a.npz", about=np.array(json.dumps({"x": 1})), a=np.ones(2))
    assert list(read_arrays(tmp_path / "a.npz", {"x": 1}, "work", ["a"])) == ["a"]


@pytest.mark.parametrize(
    ("name", "array", "words"),
    [
        ("a", None, "no array a"),
        ("a", np.zeros((2, 4)), r"a of float64 \(2, 4\); allowed: numbers \(n, 3\)"),
        ("a", np.zeros(3), "a of float64"),
        ("a", np.zeros((2, 3), int), "a of int64"),
        ("a", np.full((2, 3), np.inf), "a with a number that is not finite"),
    ],
)
def test_kinds_and_shapes_are_checked(tmp_path, name, array, words):
    arrays = {key: value for key, value in (ARRAYS | {name: array}).items() if value is not None}
    with pytest.raises(InputError, match=words):
        check_arrays(tmp_path / "a.npz", arrays, {"n": ("i", ()), "a": ("f", (None, 3))}, "work")


def test_a_link_to_nothing_does_not_let_work_begin_anew(tmp_path):
    assert read_arrays(tmp_path / "a.npz", {}, "fit") is None
    (tmp_path / "a.npz").symlink_to(tmp_path / "gone.npz")
    with pytest.raises(InputError, match=r"a\.npz: no such file"):
        read_arrays(tmp_path / "a.npz", {}, "fit")
