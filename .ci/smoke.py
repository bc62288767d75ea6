# SPDX-License-Identifier: MIT
"""A minute of everything: a twin is loaded, stepped with gradients, rendered and moved in a station; a policy acts.

It compiles most kernels. `physics` or `rendering` as an argument runs that part alone: two cores share the compiling.
"""

import platform
import sys
import tempfile

import numpy as np
import torch

import pinwm_drake as pw
from pinwm_drake.geometry.entry import collide_bodies
from pinwm_drake.models import policy_path
from pinwm_drake.physics.diagnose import inspect
from pinwm_drake.physics.impulses import contact_impulses
from pinwm_drake.rendering.losses import photometric
from pinwm_drake.spatial.poses import Pose

TWIN = pw.load_twin("t_block")


def run_rendering() -> None:
    """Render a twin with gradients of a photometric loss to the camera."""
    p_CO = torch.tensor([0.0, 0.0, 0.5], dtype=torch.float64, requires_grad=True)
    camera = pw.Camera.from_field_of_view(64, 64, fov_y=0.4)
    q_CO = torch.tensor([1.0, 0.0, 0.0, 0.0], dtype=torch.float64)
    with torch.no_grad():
        black = pw.render(TWIN.surfels, camera, Pose(q_CO, p_CO), num_threads=1).color[0] * 0.0
    photometric(pw.render(TWIN.surfels, camera, Pose(q_CO, p_CO)).color[0], black).backward()
    assert p_CO.grad.isfinite().all()


def run_physics() -> None:
    """Push a twin for a second with gradients to friction; look into its steps; the reference steps alike."""
    model, theta, start = pw.twin_physics(TWIN)
    V_WP = torch.tensor([0, 0, 0, 0.1, 0, 0], dtype=torch.float64).repeat(240, 1, 1)
    record = pw.Stepper(model).rollout(theta, start, V_WP)
    alike = pw.Stepper(model, backend="torch").step(theta, start, V_WP[0])
    torch.testing.assert_close(alike.p_WB, record.frame(1).p_WB, rtol=0.0, atol=1e-8)
    pushed = contact_impulses(model, theta, record, V_WP).sum(axis=(0, 1, 2))
    assert pushed[2] > 0, "the floor does not carry the object"
    assert inspect(model, theta, record.frame(-2), V_WP[-1]).iterations >= 0
    theta.friction.requires_grad_()
    pw.Stepper(model).rollout(theta, start, V_WP).frame(-1).p_WB[0, 0, 0].backward()
    assert theta.friction.grad.isfinite().all()
    X_WB, rows = (np.eye(3), np.zeros(3)), np.zeros((64, 16))
    assert collide_bodies(model.arrays.table, 0, *X_WB, 1, *X_WB, 1.0, rows, 0) > 0, "the pusher is far from the object"


def run_station() -> None:
    """Move a pusher in a station; evaluate the policy that ships for three steps."""
    from pydrake.systems.analysis import Simulator

    station = pw.make_station("push_t", engine="twin")
    simulator = Simulator(station)
    station.GetInputPort("pusher_velocity_W").FixValue(simulator.get_mutable_context(), [-0.1, 0.0, 0.0])
    simulator.AdvanceTo(0.2)
    image = station.GetOutputPort("rgb").Eval(simulator.get_context()).data
    assert image.shape[2] == 4
    assert image[..., 3].any(), "the object is not in the image"

    pw.read_bundle(policy_path("push_t"))
    with tempfile.TemporaryDirectory() as folder:
        request = pw.EvaluateRequest("push_t", engine="point", episodes=1, max_steps=3)
        evaluation = pw.evaluate(request, f"{folder}/evaluation")
    assert evaluation.episodes == 1


def main() -> None:
    """Run the parts one after the other; an exception ends it."""
    part = sys.argv[1] if len(sys.argv) > 1 else "all"
    if part in ("all", "rendering"):
        run_rendering()
    if part in ("all", "physics"):
        run_physics()
    if part == "all":
        run_station()
    print(f"smoke, {part}: Python {platform.python_version()}, torch {torch.__version__}: all ran")  # noqa: T201


if __name__ == "__main__":
    main()
