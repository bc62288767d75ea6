# SPDX-License-Identifier: MIT
import numpy as np
import pytest
import torch
import yaml

from benchmarks.scenes.point_mass import PointMass, PointMassWorlds
from pinwm_drake.errors import InputError, ParameterError
from pinwm_drake.learning.policy import WEIGHTS_FILE
from pinwm_drake.paper.baselines.dreamer.policy import (
    DREAMER_FILE,
    make_policy,
    read_dreamer,
    write_dreamer,
)
from tests.paper.baselines.dreamer.small import SIZES


@pytest.fixture
def policy():
    torch.manual_seed(0)
    return make_policy(PointMassWorlds(size=8).spec("rgb"), SIZES)


def rolled(policy, steps=6, worlds=3):
    """Actions (steps, worlds, 2) of a policy that is given its state."""
    env, state, actions = PointMass(worlds, 8), None, []
    env.seed(1)
    seen, begins = env.reset(), np.ones(worlds, bool)
    for _ in range(steps):
        action, state = policy.predict(seen, state, begins)
        actions.append(action)
        seen, _, begins, _ = env.step(action)
    return np.stack(actions)


def test_a_policy_that_was_read_acts_alike(policy, tmp_path):
    write_dreamer(tmp_path, policy)
    found = read_dreamer(tmp_path)
    assert found.spec == policy.spec
    assert found.networks == SIZES
    np.testing.assert_array_equal(rolled(found), rolled(policy))
    assert np.abs(rolled(policy)).max() <= 1.0
    assert sorted(path.name for path in tmp_path.iterdir()) == [DREAMER_FILE, WEIGHTS_FILE]


def test_one_world_is_treated_as_several_are(policy):
    env = PointMass(2, 8)
    seen = env.reset()
    both, _ = policy.predict(seen)
    alone, state = policy.predict({name: values[1] for name, values in seen.items()}, None, np.array([True]))
    assert alone.shape == (2,)
    np.testing.assert_allclose(alone, both[1], atol=1e-6)
    with pytest.raises(ParameterError, match="1 worlds"):
        policy.predict(seen, state)


def test_a_world_whose_episode_begins_forgets_and_the_others_do_not(policy):
    seen = PointMass(2, 8).reset()
    _, state = policy.predict(seen)
    fresh, _ = policy.predict(seen)
    later, _ = policy.predict(seen, state)
    found, _ = policy.predict(seen, state, np.array([True, False]))
    np.testing.assert_allclose(found[0], fresh[0], atol=1e-6)
    np.testing.assert_allclose(found[1], later[1], atol=1e-6)
    assert not np.allclose(fresh, later)


def test_actions_are_drawn_only_where_asked(policy):
    seen = PointMass(2, 8).reset()
    torch.manual_seed(0)
    assert not np.array_equal(
        policy.predict(seen, deterministic=False)[0], policy.predict(seen, deterministic=False)[0]
    )
    np.testing.assert_array_equal(policy.predict(seen)[0], policy.predict(seen)[0])


def test_bad_folders_are_refused(policy, tmp_path):
    with pytest.raises(InputError, match=DREAMER_FILE):
        read_dreamer(tmp_path)
    write_dreamer(tmp_path, policy)
    document = yaml.safe_load((tmp_path / DREAMER_FILE).read_text())
    document["networks"]["deter"] = 13
    (tmp_path / DREAMER_FILE).write_text(yaml.safe_dump(document))
    with pytest.raises(InputError, match=WEIGHTS_FILE):
        read_dreamer(tmp_path)
    (tmp_path / DREAMER_FILE).write_text("schema_version: 7")
    with pytest.raises(InputError, match="schema_version 1"):
        read_dreamer(tmp_path)
