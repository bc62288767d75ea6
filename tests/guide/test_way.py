# SPDX-License-Identifier: MIT
"""The way from masks to a proposal, with small budgets."""

from functools import partial

import pytest

from pinwm_drake.guide import runs
from pinwm_drake.guide.guide import guide_lab
from pinwm_drake.guide.page import PAGE_FILE
from pinwm_drake.guide.stages import ACTS, AGAIN, TRAIN
from pinwm_drake.identification.options import IdentifyOptions
from pinwm_drake.rendering.fit_options import FitOptions
from tests.guide.test_guide import brought, states

__all__ = ["brought"]
FIT = FitOptions(iterations=20, max_surfels=300)
SEARCH = IdentifyOptions(starts=1, screened=2, coarse_iterations=1, fine_iterations=1, moves=2)


@pytest.mark.nightly
def test_the_guide_goes_on_to_the_next_push_and_repeats_nothing(brought, monkeypatch):
    monkeypatch.setattr(runs, "align", partial(runs.align, options=FIT))
    monkeypatch.setattr(runs, "identify", partial(runs.identify, options=SEARCH))
    monkeypatch.setattr(runs, "next_push", partial(runs.next_push, number=2, draws=2))
    found = guide_lab(brought.path)
    assert found.error == ""
    assert {states(found)[key] for key in ("appearance", "check", "twin", "next")} == {"done"}
    assert found.act in (ACTS[AGAIN], ACTS[TRAIN])
    assert (brought.next / "trajectory.csv").is_file()
    twin = (brought.twin / "twin.yaml").read_bytes()
    ran = []
    again = guide_lab(brought.path, progress=lambda stage, *_: ran.append(stage))
    assert (again.act, ran) == (found.act, [])
    assert (brought.twin / "twin.yaml").read_bytes() == twin
    assert "next_push.png" in (brought.path / PAGE_FILE).read_text()
    scene = brought.scene
    scene.write_text(scene.read_text().replace("mass: 0.2", "mass: 0.3"))
    looked = guide_lab(brought.path, run=False)
    assert states(looked)["appearance"] == "out of date"
    assert looked.seen[-1].changed == ("capture/capture.yaml",)
