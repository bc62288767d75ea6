# SPDX-License-Identifier: MIT
import contextlib
import os
import shutil
import stat

import numpy as np
import pytest

from pinwm_drake.capture.check import check_capture
from pinwm_drake.capture.episodes import read_episode
from pinwm_drake.capture.importers.colmap import import_colmap
from pinwm_drake.capture.importers.nerfstudio import import_nerfstudio
from pinwm_drake.capture.importers.pinwm import import_pinwm
from pinwm_drake.capture.importers.similarity import scaled_world
from pinwm_drake.capture.importers.target import Scenery
from pinwm_drake.capture.scene import PusherShape, load_capture
from pinwm_drake.errors import PinwmError
from tests.capture.cube import read_static_views, write_mesh, write_views
from tests.capture.mutations import mutate
from tests.capture.pushed_cube import read_frames
from tests.capture.test_colmap import model_of, write_binary, write_text
from tests.capture.test_pinwm import GOAL, START, write_like_theirs

ROUNDS = int(os.environ.get("PINWM_FUZZ", "240"))  # mutated captures in all
PARTS = 8


def link(source, target):
    """A file that shares its contents; the mutations write new ones."""
    os.link(source, target)


def read_everything(folder):
    """Reads a capture as the other commands do."""
    capture = load_capture(folder)
    read_static_views(folder)
    for name in capture.episode_names:
        read_frames(read_episode(capture, name))


def tried(work):
    """The error that some work was refused with, or None; any other exception gets through."""
    try:
        work()
    except PinwmError as error:
        return error
    return None


def one_line(message):
    message.encode("utf-8")
    return "\n" not in message


@pytest.mark.parametrize("part", [0, *(pytest.param(part, marks=pytest.mark.nightly) for part in range(1, PARTS))])
def test_nothing_but_a_pinwm_error_comes_of_damaged_files(pushed_cube_once, tmp_path, part):
    for number in range(part, ROUNDS, PARTS):
        rng = np.random.default_rng(number)
        folder = tmp_path / f"{number}"
        shutil.copytree(pushed_cube_once, folder, copy_function=link)
        done = [mutate(folder, rng)]
        if rng.random() < 0.3 and any(path.is_file() for path in folder.rglob("*.*")):
            # The first one may have left nothing that the second could change.
            with contextlib.suppress(Exception):
                done.append(mutate(folder, rng))
        if not folder.is_dir():
            assert tried(lambda folder=folder: check_capture(folder)) is not None
            continue
        try:
            result = check_capture(folder)
            refused = tried(lambda folder=folder: read_everything(folder))
        except Exception as error:
            raise AssertionError(f"seed {number}: {done}") from error
        # What the check accepts can be used.
        assert result.errors or refused is None, f"seed {number}: {done}: {refused}"
        for problem in result.problems:
            assert one_line(str(problem.problem)), f"seed {number}: {done}: {problem.problem}"
        for path in folder.rglob("*"):
            if stat.S_IMODE(path.lstat().st_mode) == 0:
                path.chmod(0o600)
        shutil.rmtree(folder)


def importers(tmp_path_factory, pushed_cube_once):
    """Sources in each format, and how each is imported."""
    root = tmp_path_factory.mktemp("sources")
    scan = write_views(root / "nerfstudio", size=32, count=4)
    write_mesh(scan / "cube.obj")
    for kind, write in (("text", write_text), ("binary", write_binary)):
        shutil.copytree(scan, root / kind)
        write(root / kind / "sparse/0", *model_of(scan))
    write_like_theirs(pushed_cube_once, root / "pinwm", START, GOAL)
    write_mesh(root / "pinwm/cube.obj")
    shape = PusherShape("sphere", 0.01)

    def scenery(folder):
        return Scenery("cube", folder / "cube.obj", pusher_shape=shape)

    return root, {
        "nerfstudio": lambda folder, out: import_nerfstudio(folder, out, scenery(folder)),
        "text": lambda folder, out: import_colmap(folder, out, scenery(folder), scaled_world()),
        "binary": lambda folder, out: import_colmap(folder, out, scenery(folder), scaled_world()),
        "pinwm": lambda folder, out: import_pinwm(folder, out, scenery(folder), pusher_height=0.03),
    }


def test_nothing_but_a_pinwm_error_comes_of_damaged_sources(tmp_path_factory, pushed_cube_once, tmp_path):
    root, work = importers(tmp_path_factory, pushed_cube_once)
    refusals = 0
    for number in range(ROUNDS // 2):
        rng = np.random.default_rng(10**6 + number)
        name = sorted(work)[number % len(work)]
        folder, out = tmp_path / f"{number}", tmp_path / f"{number}-out"
        shutil.copytree(root / name, folder, copy_function=link)
        done = mutate(folder, rng)
        try:
            error = tried(lambda run=work[name], folder=folder, out=out: run(folder, out))
        except Exception as error:
            raise AssertionError(f"seed {number}: {name}: {done}") from error
        # A capture is whole, or not there.
        assert out.exists() == (error is None), f"seed {number}: {name}: {done}"
        if error is None:
            load_capture(out)
        else:
            refusals += 1
            assert one_line(str(error)), f"seed {number}: {name}: {done}: {error}"
        assert not list(tmp_path.glob(".*"))
        shutil.rmtree(folder, ignore_errors=True)
        shutil.rmtree(out, ignore_errors=True)
    assert refusals > ROUNDS // 8
