# SPDX-License-Identifier: MIT
import shutil
from pathlib import Path

import pytest

from pinwm_drake.learning.bundle import read_bundle
from tests.learning.bundles import SCENE, exported, image_spec, untrained_policy


@pytest.fixture(scope="session", autouse=True)
def exports(read_operators_once):
    """Many of these tests export a policy."""


@pytest.fixture(scope="session")
def whole(tmp_path_factory) -> Path:
    """The bundle of a policy of one small image."""
    return exported(tmp_path_factory.mktemp("bundle") / "bundle", untrained_policy(image_spec(16, 1, scene=SCENE)))


@pytest.fixture
def folder(whole, tmp_path) -> Path:
    """A copy, to be spoiled; it is in order as it is, so that what is refused is what the test changed."""
    copy = tmp_path / "bundle"
    shutil.copytree(whole, copy)
    read_bundle(copy)
    return copy
