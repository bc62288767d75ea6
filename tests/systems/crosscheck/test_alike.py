# SPDX-License-Identifier: MIT
import dataclasses
import math
from pathlib import Path

import numpy as np
import pytest

from pinwm_drake.capture.scene import PusherGeometry
from pinwm_drake.geometry.meshes import load_mesh
from pinwm_drake.models import model_path
from pinwm_drake.systems.crosscheck.alike import CORNERS, alike, extra_cases, like, missing, without
from pinwm_drake.systems.crosscheck.crosscheck import crosscheck
from pinwm_drake.systems.crosscheck.options import CrossCheckOptions
from pinwm_drake.systems.engines.plant.scene import lying_side
from pinwm_drake.systems.scenario.load import load_setup
from pinwm_drake.systems.scenario.schema import Scenario, Start, Theta
from pinwm_drake.systems.scenario.setup import make_setup
from pinwm_drake.systems.sdf.collision import stays_within, support_spheres
from pinwm_drake.systems.sdf.contact import SUPPORT_RADIUS
from tests.systems.scenes import with_nuisance

FRICTION = 0.1
STRONG = {"support_x": 1.5, "support_y": 1.2, "support_z": 1.5, "center_x": 0.004, "contact_offset": 0.0015}


def setup_of(**nuisance):
    start = Start(yaw=[-math.pi, math.pi])
    plain = make_setup(Scenario(object="t_block", theta=Theta(1.0, FRICTION, FRICTION, 0.0), start=start))
    return with_nuisance(plain, **nuisance)


def test_only_what_a_plant_cannot_have_is_missing():
    setup = setup_of(**STRONG, center_y=0.0)
    assert missing(setup, "point") == []
    assert missing(setup, "hydroelastic") == ["support_x", "support_y", "support_z"]
    assert missing(setup_of(support_x=1.0), "hydroelastic") == []
    hand = PusherGeometry(Path(model_path("cube/cube.obj")), None)
    of_mesh = dataclasses.replace(setup, twin=dataclasses.replace(setup.twin, pusher=hand))
    assert missing(of_mesh, "point") == ["contact_offset"]
    assert missing(setup_of(contact_offset=-0.01), "point") == ["contact_offset"]  # no radius is left of 10 mm
    corners = dataclasses.replace(setup, twin=dataclasses.replace(setup.twin, support="corners", nuisance={}))
    assert missing(corners, "point") == [CORNERS]
    assert missing(without(corners, [CORNERS]), "point") == []


def test_a_plant_is_compared_with_the_twin_that_lacks_what_it_lacks():
    setup = setup_of(**STRONG)
    cases = extra_cases(setup, ("hydroelastic", "point"))
    assert alike("hydroelastic", cases) == like("hydroelastic") == "twin like hydroelastic"
    assert alike("point", cases) == "twin"
    kept = cases["twin like hydroelastic"].twin.nuisance
    assert [kept[f"support_{axis}"].value for axis in "xyz"] == [1.0, 1.0, 1.0]
    assert (kept["center_x"].value, kept["contact_offset"].value) == (0.004, 0.0015)
    single = cases["twin without support_y"].twin.nuisance
    assert [single[f"support_{axis}"].value for axis in "xyz"] == [1.5, 1.0, 1.5]
    assert set(cases) == {"twin like hydroelastic", *(f"twin without support_{axis}" for axis in "xyz")}


def test_points_that_leave_their_side_are_spread_only_where_no_other_side_may_come_to_lie():
    mesh, down = load_mesh(model_path("cube/cube.obj")), np.array([0.0, 0.0, -1.0])
    wide, narrow = (1.5, 1.5, 1.5), (0.6, 0.6, 0.6)
    assert (stays_within(mesh, down, wide), stays_within(mesh, down, narrow)) == (False, True)

    def reach(spread, side):
        """Largest distance of the spheres of each of the six sides from the cube's middle, along one axis."""
        feet = np.array([centre for centre, radius in support_spheres(mesh, spread, side) if radius == SUPPORT_RADIUS])
        return [np.abs(feet[12 * k : 12 * k + 12]).max() for k in range(6)]

    assert sum(most > 0.031 for most in reach(wide, down)) == 1
    assert max(reach(wide, None)) < 0.031
    assert lying_side(load_setup("flip_cube")) is None
    np.testing.assert_allclose(lying_side(load_setup("push_t")), down, atol=1e-12)


def test_a_good_twin_of_strong_support_passes_and_one_of_twice_the_friction_fails():
    setup, options = setup_of(**STRONG), CrossCheckOptions(engines=("point",), pushes=1)
    (good,) = crosscheck(setup, options).verdicts
    assert good.passed
    # Measured over four: 0.6 mm and 0.1 degrees; 3.3 mm and 8 degrees where the plant's pressure was uniform.
    assert good.median_translation < 2e-3
    assert good.median_rotation < math.radians(1.0)
    wrong = setup.with_theta(friction_floor=2 * FRICTION)
    (bad,) = crosscheck(wrong, options, truth={"friction_floor": FRICTION}).verdicts
    assert not bad.passed


@pytest.mark.nightly
def test_a_plant_of_uniform_pressure_judges_like_with_like_and_tells_the_effect():
    setup, options = setup_of(**STRONG), CrossCheckOptions(engines=("hydroelastic",), pushes=1)
    found = crosscheck(setup, options)
    assert found.verdicts[0].passed
    assert [effect.name for effect in found.effects] == ["support_x", "support_y", "support_z"]
    # The block lies on the side across z: what spreads along z has no effect.
    assert found.effects[2].translation < 1e-9
    assert max(effect.rotation for effect in found.effects) > math.radians(2.0)
    assert found.words()[1].startswith("hydroelastic does not take over support_y 1.2: compared with the twin at 1; ")
