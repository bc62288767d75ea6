# SPDX-License-Identifier: MIT
import numpy as np
import pytest

import pinwm_drake as pw
from pinwm_drake.errors import ParameterError


@pytest.fixture(scope="module")
def bundle():
    return pw.read_bundle("push_t")


def test_a_bundle_acts_in_its_own_scene_within_its_own_limits(bundle):
    loop = pw.make_control_loop(bundle, "twin", armed=True)
    assert loop.station.setup.scenario.name == "push_t"
    assert loop.station.setup.camera.width == bundle.spec.camera.width
    assert loop.controller.limits == bundle.limits
    loop.begin(loop.draw_place(np.random.default_rng(2)))
    loop.listen()
    rows = list(loop.advance(0.3))
    assert [round(row.t - rows[0].t, 9) for row in rows] == [0.0, 0.1, 0.2, 0.3]
    assert np.linalg.norm(rows[-1].p_WP - rows[0].p_WP) > 0.01


def test_a_scene_of_another_object_is_refused(bundle):
    with pytest.raises(ParameterError, match="object: got cube"):
        pw.make_control_loop(bundle, scene="push_cube")
