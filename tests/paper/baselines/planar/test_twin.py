import numpy as np
import pytest
import torch

from pinwm_drake.capture.episodes import read_episode
from pinwm_drake.capture.scene import read_capture
from pinwm_drake.paper.baselines.planar.body import make_planar_body
from pinwm_drake.paper.baselines.planar.identify import PlanarProperties
from pinwm_drake.paper.baselines.planar.twin import planar_twin
from pinwm_drake.spatial.poses import Pose
from pinwm_drake.twin.origin import identified_push, start_pose
from pinwm_drake.twin.read import read_twin
from pinwm_drake.twin.rollout import twin_parameters, twin_scene
from pinwm_drake.twin.write import write_twin
from tests.capture.pushed_cube import write_pushed_cube
from tests.rendering.scenes import cloud

FOUND = PlanarProperties(0.4, (0.004, -0.003), 3e-4, 0.12, 0.3)


def test_the_twin_has_what_was_found(tmp_path):
    capture = read_capture(write_pushed_cube(tmp_path / "capture"))
    episode = read_episode(capture, "0000")
    # On another side: z of O is level, x points down, so that y of O is x of Q, and -z is y of Q.
    half = np.sqrt(0.5)
    q_WO = torch.tensor([half, 0.0, half, 0.0], dtype=torch.float64)
    body = make_planar_body(capture.object.mesh_path, q_WO, 0.0, 0.0)
    X_OS = Pose(torch.tensor([1.0, 0.0, 0.0, 0.0]).double(), torch.tensor([1e-3, 0.0, 0.0]).double())
    twin = planar_twin(FOUND, body, capture, [episode], cloud(), (0.25, -0.5), X_OS=X_OS)
    write_twin(tmp_path / "twin", twin)
    read = read_twin(tmp_path / "twin")
    assert {name: one.value for name, one in read.theta.items()} == pytest.approx(
        {"mass": 0.4, "friction_floor": 0.12, "friction_pusher": 0.3}
        | {f"inertia_{axis}": 3e-4 for axis in ("xx", "yy", "zz")}  # a cube's moments are alike
        | {"restitution_floor": 0.0, "restitution_pusher": 0.0}
    )
    assert [name for name, one in read.theta.items() if one.identifiable] == ["friction_floor", "friction_pusher"]
    moved = body.R_QO @ np.array([read.nuisance[f"center_{axis}"].value for axis in "xyz"])
    np.testing.assert_allclose(moved, [0.004, -0.003, 0.0], atol=1e-9)
    assert read.camera_offset == (0.25, -0.5)
    assert identified_push(read, capture, episode) == 0
    assert float(start_pose(read, capture, 0).p[0]) == pytest.approx(1e-3)
    # The physics takes it.
    scene = twin_scene(read, q_WO)
    parameters = twin_parameters(read, scene)
    parameters.check(scene.model)
    np.testing.assert_allclose(parameters.inertia[0, 0], 3e-4 * np.eye(3), atol=1e-12)
