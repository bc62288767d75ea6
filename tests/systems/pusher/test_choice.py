# SPDX-License-Identifier: MIT
import math

import numpy as np
import pytest
from pydrake.common.eigen_geometry import Quaternion
from pydrake.math import RigidTransform, RotationMatrix

from pinwm_drake.capture.scene import PusherShape
from pinwm_drake.geometry.meshes import load_mesh, mass_properties
from pinwm_drake.models import object_model
from pinwm_drake.systems.pusher.choice import choose_poke, choose_push
from pinwm_drake.systems.scenario.load import load_setup
from pinwm_drake.systems.scenario.start import on_floor

SPHERE = PusherShape("sphere", 0.01, 0.0)


@pytest.fixture(scope="module")
def lying_mug():
    """The mug that ships as it lies in `flip_mug`, m, world, and its centre of mass."""
    mesh, q = load_mesh(object_model("mug").mesh_path), np.array(load_setup("flip_mug").scenario.start.q_WO)
    X_WO: RigidTransform = on_floor(mesh.vertices, RotationMatrix(Quaternion(wxyz=q)), 0.0, 0.0, 0.0)
    p_WB = X_WO @ mass_properties(mesh, mass=1.0).p_com
    mesh.apply_transform(X_WO.GetAsMatrix4())
    return mesh, p_WB


@pytest.mark.nightly
def test_no_push_or_poke_starts_in_a_mug_that_lies(lying_mug):
    mesh, p_WB = lying_mug
    low, high = mesh.bounds
    for seed in range(40):
        generator = np.random.default_rng(seed)
        push = choose_push(mesh, p_WB, SPHERE, generator, height=p_WB[2], speed=0.1, distance=0.05)
        poke = choose_poke(mesh, p_WB, SPHERE, generator, floor_height=0.0)
        for start in (push.p_WP, poke.p_WP):
            assert ((start < low) | (start > high))[:2].any(), seed


def test_a_poke_is_as_asked_for(lying_mug):
    mesh, p_WB = lying_mug
    for seed in range(5):
        poke = choose_poke(
            mesh,
            p_WB,
            SPHERE,
            np.random.default_rng(seed),
            floor_height=0.0,
            speeds=(0.4, 0.5),
            rises=(0.2, 0.3),
            distances=(0.03, 0.04),
        )
        assert 0.4 <= poke.speed <= 0.5
        assert 0.2 <= math.asin(poke.direction_W[2]) <= 0.3
        assert 0.03 < poke.distance < 0.044
        assert poke.p_WP[2] > SPHERE.radius
        points = mesh.sample(20000)
        gap = np.linalg.norm(points - poke.p_WP, axis=1).min() - SPHERE.radius
        assert 1e-3 < gap < 6e-3
