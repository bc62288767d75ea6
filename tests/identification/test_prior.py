# SPDX-License-Identifier: MIT
import dataclasses
import shutil

import numpy as np
import pytest

from pinwm_drake.capture.scene import load_capture
from pinwm_drake.errors import InputError
from pinwm_drake.identification.options import IdentifyOptions
from pinwm_drake.identification.prior import capture_without_pushes, prior_twin
from pinwm_drake.twin.frame import pivot_of
from tests.capture.pushed_cube import write_pushed_cube


@pytest.fixture
def folder(tmp_path):
    write_pushed_cube(tmp_path)
    shutil.rmtree(tmp_path / "episodes")
    return tmp_path


def test_the_draws_are_those_of_the_priors(folder):
    twin = prior_twin(load_capture(folder))
    logarithm = np.log(twin.draws.column("friction_floor"))
    # Two Gaussians of 1 whose difference is within 1.5: the variance is (1 + 1 / 2.25) / (1 + 2 / 2.25).
    assert logarithm.mean() == pytest.approx(np.log(0.2), abs=0.15)
    assert logarithm.std() == pytest.approx(0.874, abs=0.1)
    assert 1e3 * twin.draws.column("frame_x").std() == pytest.approx(1.5, abs=0.2)
    assert not any(one.identifiable for one in twin.theta.values())
    assert twin.theta["mass"].value == pytest.approx(0.2)
    assert twin.theta["friction_floor"].interval[1] > 0.8


def test_its_log_turns_about_the_object_and_not_about_the_origin(folder):
    capture = load_capture(folder)
    X_WO = capture.object.X_WO
    away = X_WO._replace(p=X_WO.p + X_WO.p.new_tensor([0.5, 0.2, 0.0]))
    twin = prior_twin(dataclasses.replace(capture, object=dataclasses.replace(capture.object, X_WO=away)))
    assert pivot_of(twin).tolist() == away.p.tolist()


def test_a_mesh_that_is_off_widens_the_contact(folder):
    capture = load_capture(folder)
    off = dataclasses.replace(capture, object=dataclasses.replace(capture.object, mesh_error=5e-3))
    near, far = (prior_twin(one).draws.column("contact_offset").std() for one in (capture, off))
    assert far > 3.0 * near


def test_what_is_held_does_not_vary(folder):
    twin = prior_twin(load_capture(folder), IdentifyOptions(free=("friction_floor",), held={"friction_pusher": 0.4}))
    assert twin.theta["friction_pusher"].value == pytest.approx(0.4)
    assert np.ptp(twin.draws.column("friction_pusher")) == 0.0
    assert np.ptp(twin.draws.column("friction_floor")) > 0.1


def test_a_capture_with_pushes_is_refused(folder):
    assert capture_without_pushes(folder).episode_names == []
    assert capture_without_pushes(folder / "static") is None
    (folder / "episodes/0000").mkdir(parents=True)
    with pytest.raises(InputError, match="pinwm identify makes, or a capture without pushes"):
        capture_without_pushes(folder)
