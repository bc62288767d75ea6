# SPDX-License-Identifier: MIT
import numpy as np
import pytest
import torch
from pydrake.math import RigidTransform
from pydrake.systems.analysis import Simulator
from pydrake.systems.framework import DiagramBuilder

from pinwm_drake.learning.actors import LEVELS
from pinwm_drake.learning.bundle import read_bundle
from pinwm_drake.learning.export import export_policy
from pinwm_drake.learning.policy import Policy, make_actor
from pinwm_drake.learning.safety import default_limits
from pinwm_drake.systems.control.controller import AddPolicyController
from pinwm_drake.systems.envs.policy_scene import spec_environment
from pinwm_drake.systems.scenario.start import Place
from pinwm_drake.systems.station.station import make_station
from tests.systems.policies import LONGEST, small_setup, spec_of

ACTIONS = 6
PLACE = Place(RigidTransform([0.0, 0.0, 0.025]), np.array([0.0, 0.13, 0.025]))


@pytest.fixture(scope="module")
def policy():
    """Not trained, but it goes to the block, and a little to the sides as the images have it."""
    spec = spec_of(small_setup())
    torch.manual_seed(0)
    actor = make_actor(spec).eval()
    env = spec_environment(spec, small_setup(), "twin")
    seen = [env.reset(options={"place": PLACE})[0]]
    seen += [env.step(np.array([0.0, -2 / 3]))[0] for _ in range(ACTIONS)]
    with torch.no_grad():
        logits = actor.head(
            actor.latent({name: torch.from_numpy(np.stack([one[name] for one in seen])) for name in seen[0]})
        )
        logits = logits.unflatten(1, (2, -1))
        scale = 1.0 / logits[:, 0].std(0)
        n, levels = len(LEVELS), torch.tensor(LEVELS)
        actor.head.bias[:n] = (actor.head.bias[:n] - logits[:, 0].mean(0)) * scale
        actor.head.weight[:n] *= scale[:, None]
        actor.head.bias[:n][levels.abs() > 0.34] -= 100.0  # no more than a third along x
        actor.head.bias[n:][(levels + 2 / 3).abs().argmin()] = 100.0  # two thirds back along y
    return Policy(spec, actor)


@pytest.fixture(scope="module")
def bundle(policy, tmp_path_factory):
    folder = tmp_path_factory.mktemp("bundle") / "push"
    images = np.random.default_rng(0).integers(0, 256, (2, *policy.spec.image_shape)).astype(np.uint8)
    export_policy(policy, folder, limits=default_limits(policy.spec), samples=(images, np.zeros((2, 2))))
    return read_bundle(folder)


def test_a_bundle_in_a_station_does_what_the_policy_does_in_the_environment(policy, bundle):
    env = spec_environment(policy.spec, small_setup(), "twin")
    seen, expected = env.reset(options={"place": PLACE})[0], []
    for _ in range(ACTIONS):
        action = policy.predict(seen)[0]
        seen = env.step(action)[0]
        expected.append([*env.task.translation(action, LONGEST)[0, :2], *env.run.object_state[0, 4:7]])
    builder = DiagramBuilder()
    station = builder.AddSystem(make_station(small_setup(), "twin"))
    controller = AddPolicyController(builder, station, bundle, bundle.limits)
    diagram = builder.Build()
    simulator = Simulator(diagram)
    context = simulator.get_mutable_context()
    station.SetPlace(context, PLACE)
    controller.Arm(context)
    path = []
    for k in range(ACTIONS):
        simulator.AdvanceTo((k + 1) * station.setup.period)
        d_W = controller.GetOutputPort("raw_action").Eval(controller.GetMyContextFromRoot(context))
        path.append([*d_W, *station.object_pose(context).translation()])
    # One reads the pusher's position across the box, the other in metres, both in float32: 3e-8 m, which the network
    # makes more of. Measured 1.3e-7 m.
    np.testing.assert_allclose(path, expected, rtol=0.0, atol=3e-7)
    assert np.ptp(np.array(path)[:, :2], axis=0).max() > 1e-3 * LONGEST, "the actions do not depend on what is seen"
    assert np.linalg.norm(path[-1][2:4]) > 0.005, "the object was not pushed"
    assert controller.status(context).state == "running"
