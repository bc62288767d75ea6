# SPDX-License-Identifier: MIT
import shlex

import pytest
import yaml

from pinwm_drake.capture.check import check_capture
from pinwm_drake.capture.ground_truth import GROUND_TRUTH_FILE
from pinwm_drake.capture.scene import load_capture
from pinwm_drake.demo.options import shipped_capture
from pinwm_drake.report.twin.data import read_ground_truth


@pytest.fixture(scope="module")
def made() -> dict:
    """How the capture was made, as the file beside it says."""
    return yaml.safe_load((shipped_capture().parent / "t_block.yaml").read_text())


def test_the_shipped_capture_has_no_problem():
    result = check_capture(shipped_capture())
    assert result.problems == []
    assert list(result.images) == ["0000", "0001"]


def test_the_shipped_capture_is_what_its_command_makes(made):
    words = shlex.split(made["command"])
    assert words[:3] == ["pinwm", "capture", "simulate"]
    given = dict(zip(words[3:-1:2], words[4:-1:2], strict=True))
    result, capture = check_capture(shipped_capture()), load_capture(shipped_capture())
    assert capture.object.name == given["--object"]
    assert result.views == int(given["--static-views"])
    assert set(result.images.values()) == {int(given["--frames"])}
    truth = read_ground_truth(shipped_capture() / GROUND_TRUTH_FILE)
    assert truth["friction_floor"] == float(given["--friction"])


def test_the_shipped_capture_is_small():
    assert sum(path.stat().st_size for path in shipped_capture().rglob("*") if path.is_file()) < 700_000
