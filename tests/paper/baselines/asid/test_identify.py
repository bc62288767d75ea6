# SPDX-License-Identifier: MIT
from dataclasses import replace

import numpy as np
import pytest

from pinwm_drake.capture.episodes import read_episode
from pinwm_drake.capture.scene import load_capture
from pinwm_drake.errors import ParameterError
from pinwm_drake.geometry.meshes import load_mesh, mass_properties
from pinwm_drake.identification.poses.tracker import PoseTrackerOptions
from pinwm_drake.paper.baselines.asid.cross_entropy import GENEROUS, CrossEntropyBudget
from pinwm_drake.paper.baselines.asid.identify import AsidOptions, identify_asid, physical
from pinwm_drake.report.twin.score import pose_errors
from pinwm_drake.twin.origin import identified_push
from pinwm_drake.twin.read import load_twin
from pinwm_drake.twin.rollout import rollout
from pinwm_drake.twin.twin import THETA
from pinwm_drake.twin.write import write_twin
from tests.identification.samples import SIDE, TRUTH, surfels, write_capture, write_episode

QUICK = PoseTrackerOptions(size=40.0, num_threads=1)


@pytest.fixture(scope="module")
def pushed(tmp_path_factory):
    """A capture of two pushes of a cube whose mass is not known."""
    folder = write_capture(tmp_path_factory.mktemp("asid") / "capture")
    write_episode(folder, folder / "episodes/0001", offset=-0.004)
    capture = load_capture(folder)
    return capture, [read_episode(capture, name) for name in ("0000", "0001")]


def found(pushed, budget=None, *, seed=0, exact=True, pushes=2, **changes):
    capture, episodes = pushed
    options = AsidOptions(budget or CrossEntropyBudget(), tracker=QUICK, num_threads=1, **changes)
    poses = [episode.object_poses for episode in episodes[:pushes]] if exact else None
    return identify_asid(capture, episodes[:pushes], surfels(), (0.0, 0.0), options, seed=seed, poses=poses)


@pytest.mark.nightly
def test_theta_is_recovered_from_exact_poses(pushed):
    result = found(pushed, GENEROUS)
    theta = {name: one.value for name, one in result.twin.theta.items()}
    # The cube comes to rest after s = v^2 / (2 mu g), and its turn tells the moment about z by the mass. Searches of
    # four seeds had them within 0.05 % and 0.5 %, and poses within 0.013 mm. The pusher hardly slips, and contacts
    # hardly bounce, so that its friction, restitutions and the mass alone have no say.
    assert theta["friction_floor"] == pytest.approx(TRUTH["friction_floor"], rel=5e-3)
    assert theta["inertia_zz"] / theta["mass"] == pytest.approx(SIDE**2 / 6.0, rel=0.02)
    assert np.sqrt(result.minimum.value) < 5e-5


def test_one_unknown_is_looked_for_alone_while_the_others_have_given_values(pushed):
    held = {"friction_pusher": 0.3, "restitution_floor": 0.0, "restitution_pusher": 0.0, "inertia": 1.0, "mass": 2.0}
    budget = CrossEntropyBudget(samples=60, elites=12, rounds=8)
    result = found(pushed, budget, free=("friction_floor",), held=held)
    theta = {name: one.value for name, one in result.twin.theta.items()}
    assert result.minimum.point.shape == (1,)
    assert theta["friction_floor"] == pytest.approx(TRUTH["friction_floor"], rel=5e-3)
    assert (theta["friction_pusher"], theta["mass"]) == (TRUTH["friction_pusher"], 2.0)
    assert theta["inertia_zz"] == pytest.approx(2.0 * SIDE**2 / 6.0, rel=1e-3)
    held = TRUTH | {"restitution_floor": 0.0, "restitution_pusher": 0.0, "inertia": 1.0}
    result = found(pushed, budget, free=("mass",), held=held)
    theta = {name: one.value for name, one in result.twin.theta.items()}
    # With the moments of a uniform cube of 1 kg, the way it turns tells the mass.
    assert theta["inertia_zz"] == pytest.approx(SIDE**2 / 6.0, rel=1e-3)
    assert theta["mass"] == pytest.approx(1.0, rel=0.02)
    with pytest.raises(ParameterError, match="held"):
        AsidOptions(free=("friction_floor",), held={"mass": 1.0})
    with pytest.raises(ParameterError, match="free"):
        AsidOptions(free=("colour",))


def test_the_default_budget_gives_a_twin_that_can_be_written(pushed, tmp_path):
    result = found(pushed)
    assert len(result.minimum.rounds) == 10
    write_twin(tmp_path / "twin", result.twin)
    twin = load_twin(tmp_path / "twin")
    assert set(twin.theta) == set(THETA)
    assert twin.provenance["method"] == "asid"
    assert identified_push(twin, pushed[0], pushed[1][1]) == 1
    # The twin's own rollout is the simulation that the search compared.
    capture, (episode, _) = pushed
    errors = pose_errors(rollout(twin, capture.object.X_WO, episode.trajectory, episode.t), episode.object_poses)
    assert np.sqrt(np.mean(errors.position**2)) < 1.5 * np.sqrt(result.minimum.value) + 1e-4


def test_values_are_in_their_ranges_and_moments_are_of_the_mass(pushed):
    result = found(pushed, CrossEntropyBudget(samples=8, elites=2, rounds=2), pushes=1, inertia=(1.5, 1.5001))
    theta = {name: one.value for name, one in result.twin.theta.items()}
    assert 0.2 <= theta["mass"] <= 5.0
    solid = mass_properties(load_mesh(pushed[0].object.mesh_path), mass=theta["mass"]).inertia.diagonal()
    moments = [theta[f"inertia_{axis}"] for axis in ("xx", "yy", "zz")]
    assert moments == pytest.approx(1.5 * solid, rel=1e-3)


def test_a_measured_mass_is_held(pushed):
    capture, episodes = pushed
    known = replace(capture, object=replace(capture.object, mass=0.4))
    result = found((known, episodes), CrossEntropyBudget(samples=4, elites=2, rounds=1), pushes=1)
    assert result.twin.theta["mass"].value == 0.4
    assert result.twin.theta["mass"].note == "as the capture says"


def test_poses_are_tracked_where_none_are_given(pushed):
    result = found(pushed, CrossEntropyBudget(samples=8, elites=2, rounds=2), exact=False, pushes=1)
    assert result.twin.provenance["poses"] == "tracked"
    truth = pushed[1][0].object_poses
    assert pose_errors(result.poses[0], truth).position.max() < 5e-3
    assert result.poses[0] is not truth


def test_a_seed_gives_the_same_twin(pushed):
    budget = CrossEntropyBudget(samples=6, elites=2, rounds=2)
    first, again, other = (found(pushed, budget, seed=seed, pushes=1).twin.theta for seed in (1, 1, 2))
    assert first == again
    assert first != other


def test_poses_at_other_times_are_interpolated(pushed):
    capture, (episode, _) = pushed
    result = found(pushed, CrossEntropyBudget(samples=4, elites=2, rounds=1), pushes=1)
    truth = episode.object_poses
    # A pose between each two: on the straight line, where the frames' own poses are what they were.
    t = np.sort(np.concatenate([truth.t, 0.5 * (truth.t[1:] + truth.t[:-1])]))
    p = np.stack([np.interp(t, truth.t, column) for column in truth.p_WO.T], -1)
    q = np.stack([np.interp(t, truth.t, column) for column in truth.q_WO.T], -1)
    finer = replace(truth, t=t, p_WO=p, q_WO=q / np.linalg.norm(q, axis=1, keepdims=True))
    options = AsidOptions(CrossEntropyBudget(samples=4, elites=2, rounds=1), num_threads=1)
    again = identify_asid(capture, episode, surfels(), (0.0, 0.0), options, seed=0, poses=[finer])
    assert again.minimum.value == pytest.approx(result.minimum.value, rel=1e-9)


def test_poses_that_end_early_are_refused(pushed):
    capture, (episode, _) = pushed
    truth = episode.object_poses
    short = replace(truth, t=truth.t[:-1], p_WO=truth.p_WO[:-1], q_WO=truth.q_WO[:-1])
    with pytest.raises(ParameterError, match=r"poses: got 0 to 0\.5 s"):
        identify_asid(capture, episode, surfels(), (0.0, 0.0), seed=0, poses=[short])


@pytest.mark.parametrize("chosen", [[], [0, 0]])
def test_pushes_that_cannot_be_used_are_refused(pushed, chosen):
    capture, episodes = pushed
    with pytest.raises(ParameterError, match="episodes"):
        identify_asid(capture, [episodes[k] for k in chosen], surfels(), (0.0, 0.0), seed=0)


@pytest.mark.parametrize(
    "change",
    [
        {"friction": (0.5, 0.005)},
        {"friction": (0.0, 0.5)},
        {"restitution": (0.0, 1.5)},
        {"inertia": (0.3, float("nan"))},
        {"mass": (-1.0, 5.0)},
        {"time_step": 0.0},
        {"num_threads": 0},
    ],
)
def test_settings_out_of_range_are_refused(change):
    with pytest.raises(ParameterError, match=next(iter(change))):
        AsidOptions(**change)


def test_unknowns_are_even_in_their_logarithms():
    ranges = {"friction_floor": (0.005, 0.5), "restitution_floor": (0.0, 0.5)}
    values = physical(np.array([[0.0, 0.0], [0.5, 0.5], [1.0, 1.0]]), ranges)
    assert values["friction_floor"] == pytest.approx([0.005, 0.05, 0.5])
    assert values["restitution_floor"] == pytest.approx([0.0, 0.25, 0.5])
