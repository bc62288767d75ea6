# SPDX-License-Identifier: MIT
import numpy as np
import pytest
import trimesh
from pydrake.math import RigidTransform, RotationMatrix

from pinwm_drake.capture.scene import PusherShape
from pinwm_drake.errors import ParameterError
from pinwm_drake.systems.runs.recorder import Recording
from pinwm_drake.systems.runs.rocking import rocking_poke

SIZE = 0.06  # m, of the cube
TIMES = np.linspace(0.0, 2.0, 201)
SPHERE = PusherShape("sphere", 0.01)


def pose(slide, rise):
    """The cube moved along x, and turned about its lower edge of largest x so far that its middle rises."""
    half = SIZE / 2
    angle = np.arcsin((half + rise) / (np.sqrt(2) * half)) - np.pi / 4
    edge = RigidTransform([half, 0.0, 0.0])
    return (
        RigidTransform([slide, 0.0, 0.0])
        @ edge
        @ RigidTransform(RotationMatrix.MakeYRotation(angle), [0.0] * 3)
        @ (edge.inverse() @ RigidTransform([0.0, 0.0, half]))
    )


class Played:
    """Recorder whose pokes move the cube as it is told, one way (slide, rise) [m] after the other."""

    def __init__(self, *ways):
        self.ways, self.seen = list(ways), []

    def push(self, X_WO, push, number, watch):
        slide, rise = self.ways.pop(0)
        bump = np.exp(-(((TIMES - 0.15) / 0.05) ** 2))
        poses = [pose(slide * min(t, 1.0), rise * height) for t, height in zip(TIMES, bump, strict=True)]
        self.seen.append(0.0)
        for t, X in zip(TIMES, poses, strict=True):
            self.seen[-1] = t
            watch(t, X)
        return Recording(TIMES, None, None, poses, np.zeros((len(TIMES), 3)), poses)


def poke(recorder, **rises):
    mesh = trimesh.creation.box((SIZE, SIZE, SIZE))
    return rocking_poke(recorder, pose(0.0, 0.0), mesh, SPHERE, np.random.default_rng(0), (0.3, 0.5), 49, **rises)


def test_a_poke_makes_the_object_slide_and_rock():
    # One does not lift it, one nearly turns it over, one lifts it where it stands.
    recorder = Played((0.05, 0.0), (0.05, 0.011), (0.01, 0.003), (0.05, 0.003))
    found, recording = poke(recorder)
    assert recording.logged[-1].translation()[0] == pytest.approx(0.05)
    assert not recorder.ways
    # The first two are not followed to their ends.
    level, over, slow, good = recorder.seen
    assert over < 0.5
    assert level < 1.0
    assert slow == good == TIMES[-1]
    assert 0.3 < found.speed < 0.5


def test_a_poke_rises_as_it_is_asked_to():
    found, _ = poke(Played((0.05, 0.003)), rises=(0.5, 0.55))
    assert 0.5 < np.arcsin(found.direction_W[2]) < 0.55


def test_where_no_poke_rocks_the_object_the_error_says_so():
    with pytest.raises(ParameterError, match="none of 60 of which makes the object slide and rock"):
        poke(Played(*[(0.05, 0.0)] * 60))
