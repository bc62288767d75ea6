# SPDX-License-Identifier: MIT
import shutil

import pytest

from tests.capture.pushed_cube import write_pushed_cube


@pytest.fixture(scope="session")
def pushed_cube_once(tmp_path_factory):
    """The capture of `pushed_cube`; not to be changed."""
    return write_pushed_cube(tmp_path_factory.mktemp("pushed") / "capture")


@pytest.fixture
def pushed_cube(pushed_cube_once, tmp_path):
    """A copy of the capture of `pushed_cube`, to be changed."""
    return shutil.copytree(pushed_cube_once, tmp_path / "capture")
