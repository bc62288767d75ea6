# SPDX-License-Identifier: MIT
"""A minute of everything: a twin is loaded, stepped with gradients, rendered and moved in a station; a policy acts."""

import platform
import tempfile

import torch

import pinwm_drake as pw
from pinwm_drake.models import policy_path
from pinwm_drake.spatial.poses import Pose


def main() -> None:
    """Run the parts one after the other; an exception ends it."""
    twin = pw.load_twin("t_block")
    p_CO = torch.tensor([0.0, 0.0, 0.5], dtype=torch.float64, requires_grad=True)
    camera = pw.Camera.from_field_of_view(64, 64, fov_y=0.4)
    q_CO = torch.tensor([1.0, 0.0, 0.0, 0.0], dtype=torch.float64)
    pw.render(twin.surfels, camera, Pose(q_CO, p_CO)).color.sum().backward()
    assert p_CO.grad.isfinite().all()
    model, theta, start = pw.twin_physics(twin)
    theta.friction.requires_grad_()
    V_WP = torch.tensor([0, 0, 0, 0.1, 0, 0], dtype=torch.float64).repeat(240, 1, 1)
    end = pw.Stepper(model).rollout(theta, start, V_WP, record_every=240).frame(-1)
    end.p_WB[0, 0, 0].backward()
    assert theta.friction.grad.isfinite().all()
    from pydrake.systems.analysis import Simulator

    station = pw.make_station("push_t", engine="twin")
    simulator = Simulator(station)
    station.GetInputPort("pusher_velocity_W").FixValue(simulator.get_mutable_context(), [-0.1, 0.0, 0.0])
    simulator.AdvanceTo(0.2)
    image = station.GetOutputPort("rgb").Eval(simulator.get_context()).data
    assert image.shape[2] == 4
    assert image[..., 3].any(), "the object is not in the image"

    bundle = pw.read_bundle(policy_path("push_t"))
    with tempfile.TemporaryDirectory() as folder:
        request = pw.EvaluateRequest("push_t", engine="point", episodes=1, max_steps=3)
        evaluation = pw.evaluate(request, f"{folder}/evaluation")
    assert evaluation.episodes == 1
    print(f"smoke: Python {platform.python_version()}, torch {torch.__version__}, bundle {bundle.sha256[:8]}: all ran")  # noqa: T201


if __name__ == "__main__":
    main()
