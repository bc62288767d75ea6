# SPDX-License-Identifier: MIT
import numpy as np
import pytest
from pydrake.math import RigidTransform

from pinwm_drake.models import model_path
from pinwm_drake.report.scene import PLAIN
from pinwm_drake.systems.runs.film import Film, object_actors
from pinwm_drake.systems.scenario.load import load_setup

TWIN = str(model_path("twins/t_block/twin.yaml").parent)


def hues(picture: np.ndarray) -> set[str]:
    """Colours of which there is much in a picture."""
    red, green, blue = (picture[..., k].astype(int) for k in range(3))
    found = {
        "red": red - green,
        "green": green - red,
        "blue": blue - red,
        "orange": np.minimum(red - blue, green - blue),
    }
    return {name for name, more in found.items() if (more > 60).sum() > 20}


@pytest.mark.parametrize("scene", ["push_t", TWIN])
def test_an_object_wears_its_own_colours_or_those_of_its_twin(scene):
    setup = load_setup(scene)
    film = Film(setup, "twin")
    rgb = np.full((setup.camera.height, setup.camera.width, 4), 255, np.uint8)
    frame = film.frame(0.0, RigidTransform([0.0, 0.0, 0.025]), np.array([0.1, 0.05, 0.03]), rgb)
    scene_half = frame[:, : frame.shape[1] // 2]
    assert hues(scene_half) >= {"red", "green", "blue", "orange"}


def test_a_twin_is_one_mesh_with_paint_and_an_object_has_a_surface_a_material():
    (actor,) = object_actors(load_setup(TWIN))
    assert actor.paint is not None
    assert tuple(actor.colour) == PLAIN
    actors = object_actors(load_setup("push_t"))
    assert len(actors) > 8
    assert all(one.paint is None for one in actors)
