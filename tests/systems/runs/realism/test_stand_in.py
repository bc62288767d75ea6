# SPDX-License-Identifier: MIT
import dataclasses
import math

import numpy as np
import pytest

from pinwm_drake.errors import InputError, ParameterError
from pinwm_drake.geometry.meshes import load_mesh, mass_properties
from pinwm_drake.geometry.stored_pieces import mesh_pieces
from pinwm_drake.systems.envs.worlds import Worlds
from pinwm_drake.systems.runs.realism.stand_in import StandIn
from pinwm_drake.systems.scenario.load import load_setup
from pinwm_drake.systems.sdf.twin import twin_solid


@pytest.fixture(scope="module")
def believed():
    return load_setup("push_t")


def test_the_object_is_uneven(believed, tmp_path):
    true = StandIn().true_scene(believed, tmp_path)
    off = twin_solid(true.twin).p_OB - mass_properties(load_mesh(believed.twin.mesh_path), mass=1.0).p_com
    assert np.linalg.norm(off) > 1e-3
    lowest = [min(piece.vertices[:, 2].min() for piece in mesh_pieces(one.twin.mesh_path)) for one in (true, believed)]
    assert lowest[1] - lowest[0] == pytest.approx(7e-5, abs=1e-9)
    assert true.renderer.cast_shadows
    # The plants make contact meshes of these pieces: the object rests on feet, into whose small faces the floor gives.
    worlds = Worlds(true, "hydroelastic")
    worlds.reset([0])
    worlds.advance(np.zeros((1, 2)))
    assert 0.02501 < worlds.run.object_state[0, 6] < 0.02507


def test_the_camera_is_off_by_the_numbers_in_directions_of_the_station(believed, tmp_path):
    along, about = [], []
    for seed in range(8):
        stand_in, folder = StandIn(seed=seed), tmp_path / str(seed)
        folder.mkdir()
        true = stand_in.true_scene(believed, folder).X_WC
        way = true.translation() - believed.X_WC.translation()
        turn = (believed.X_WC.rotation().inverse() @ true.rotation()).ToAngleAxis()
        assert np.linalg.norm(way) == pytest.approx(0.003)
        assert turn.angle() == pytest.approx(math.radians(0.5))
        along.append(way / 0.003)
        about.append(turn.axis())
    for directions in (np.array(along), np.array(about)):
        cosines = directions @ directions.T
        assert cosines.min() < -0.5
        assert cosines[~np.eye(8, dtype=bool)].max() < 0.999


@pytest.mark.nightly
def test_a_round_object_lies_at_rest_as_an_episode_begins(tmp_path):
    believed = load_setup("flip_mug")
    assert believed.scenario.start.rolls > 1
    worlds = Worlds(StandIn().true_scene(believed, tmp_path), "hydroelastic")
    for seed in range(3):
        worlds.reset([seed])
        before = worlds.run.object_state[0].copy()
        for _ in range(3):
            worlds.advance(np.zeros((1, 3)))
        moved = worlds.run.object_state[0] - before
        assert np.linalg.norm(moved[4:7]) < 1e-3
        assert np.linalg.norm(moved[:4]) < 0.01


def test_masks_are_ragged_and_still_show_the_object():
    image = np.full((64, 64, 4), (255, 255, 255, 0), np.uint8)
    image[20:40, 20:44] = (200, 10, 10, 255)
    spoil, again = StandIn().spoil(), StandIn().spoil()
    seen = [spoil(image, np.random.default_rng(k)) for k in range(4)]
    np.testing.assert_array_equal(seen[0], again(image, np.random.default_rng(0)))
    shown = np.array([one[..., 3] > 0 for one in seen])
    assert (shown != (image[..., 3] > 0)).any(axis=(1, 2)).any()
    assert (shown != shown[0]).any()
    assert shown[:, 22:38, 22:42].all()
    assert not np.delete(np.delete(shown, np.s_[18:42], 1), np.s_[18:46], 2).any()


def test_what_makes_no_sense_is_refused(believed, tmp_path):
    with pytest.raises(ParameterError, match="stand-in latency"):
        StandIn(latency=-0.1)
    bare = dataclasses.replace(believed, visual_path=tmp_path / "bare.obj")
    with pytest.raises(InputError, match="no materials"):
        StandIn().true_scene(bare, tmp_path)
