# SPDX-License-Identifier: MIT
import math
import shutil

import pytest
import yaml

from pinwm_drake.experiments import next_push as module
from pinwm_drake.experiments import proposal as words
from pinwm_drake.twin.write import write_twin
from tests.capture.pushed_cube import write_pushed_cube
from tests.experiments.test_next_push import unsure
from tests.twin.samples import cube_twin


@pytest.fixture
def asked(monkeypatch):
    """The box that is asked for, and nothing computed."""
    found = {}

    def next_push(twin, *, low, high, **options):
        found.update(low=low, high=high, tolerance=options["tolerance"])
        options["report"](1.0)

    monkeypatch.setattr(module, "next_push", next_push)
    monkeypatch.setattr(words, "describe", lambda twin, proposal: ["push it"])
    monkeypatch.setattr(words, "write_proposal", lambda folder, twin, proposal: [folder / "push.yaml"])
    return found


def test_a_push_is_proposed_in_words_and_files(pinwm, asked, tmp_path):
    out = tmp_path / "next"
    assert pinwm("next-push", "t_block", "-o", str(out)) == (0, f"push it\nwrote {out / 'push.yaml'}\n", "")
    assert asked == {
        "low": (-math.inf, -math.inf),
        "high": (math.inf, math.inf),
        "tolerance": (2e-3, pytest.approx(math.radians(2.0))),
    }
    assert pinwm("next-push", "--config", str(out / "next-push.config.yaml"))[0] == 0


def test_a_box_is_taken(pinwm, asked, tmp_path):
    box = ("--low", "-0.2", "-0.1", "--high", "0.2", "0.1")
    assert pinwm("next-push", "t_block", "-o", str(tmp_path / "a"), *box)[0] == 0
    assert (asked["low"], asked["high"]) == ((-0.2, -0.1), (0.2, 0.1))
    code, _, errors = pinwm(
        "next-push", "t_block", "-o", str(tmp_path / "b"), "--low", "0.3", "0", "--high", "0.2", "0.1"
    )
    assert code == 1
    assert "--low, --high: got (0.3, 0.0) and (0.2, 0.1); allowed: low below high" in errors


def test_a_push_is_proposed_anywhere_and_again_by_its_configuration(pinwm, tmp_path):
    write_twin(tmp_path / "twin", unsure(cube_twin(tmp_path), 0.5))
    options = ["--candidates", "2", "--draws", "2"]
    code, output, errors = pinwm("next-push", str(tmp_path / "twin"), "-o", str(tmp_path / "next"), *options)
    assert code == 0
    told = "warning: cube: it does not say which capture it is from; "
    instead = ["pushes are level; --motion poke proposes pokes", "the object starts upright at the origin"]
    assert errors.splitlines() == [told + one for one in instead]
    assert output.splitlines()[-1] == f"wrote {tmp_path / 'next/next_push.png'}"
    again = ["-o", str(tmp_path / "again"), "--config", str(tmp_path / "next/next-push.config.yaml")]
    assert pinwm("next-push", str(tmp_path / "twin"), *again)[0] == 0
    first, second = (yaml.safe_load((tmp_path / name / "push.yaml").read_text()) for name in ("next", "again"))
    assert first == second


def test_the_first_push_of_a_capture_is_proposed(pinwm, tmp_path):
    write_pushed_cube(tmp_path / "capture")
    shutil.rmtree(tmp_path / "capture/episodes")
    options = ["--candidates", "2", "--draws", "2"]
    code, output, errors = pinwm("next-push", str(tmp_path / "capture"), "-o", str(tmp_path / "first"), *options)
    assert (code, errors) == (0, "")
    assert "so a push is worth filming" in output
    assert (tmp_path / "first/trajectory.csv").is_file()
