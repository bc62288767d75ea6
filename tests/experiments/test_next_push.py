# SPDX-License-Identifier: MIT
"""The choice of the next push, on a cube whose friction two of the draws disagree on."""

import csv
import dataclasses
import warnings

import numpy as np
import pytest
import torch

from pinwm_drake.capture.episodes import read_episode
from pinwm_drake.capture.scene import load_capture
from pinwm_drake.errors import ParameterError
from pinwm_drake.experiments.next_push import deciding_friction, filmed_motion, next_push, start_of
from pinwm_drake.twin.origin import Origin
from pinwm_drake.twin.twin import Draws
from tests.capture.pushed_cube import write_pushed_cube
from tests.twin.samples import cube_twin

NUMBER = 6
STEADY = 3.0  # amplification of a start aside, above which a push comes last


def unsure(twin, spread, number=16):
    """The twin with draws in which the logarithm of the floor's friction has this standard deviation."""
    z = np.linspace(-1.5, 1.5, number)
    values = {key: np.full(number, one.value) for key, one in twin.theta.items()}
    values["friction_floor"] = 0.2 * np.exp(spread * z)
    return dataclasses.replace(twin, draws=Draws(list(values), np.stack(list(values.values()), -1)))


@pytest.fixture(scope="module")
def twin(tmp_path_factory):
    return cube_twin(tmp_path_factory.mktemp("next"))


@pytest.fixture(scope="module")
def proposal(twin):
    return next_push(unsure(twin, 0.5), number=NUMBER, draws=8)


def test_the_push_that_tells_most_comes_first(proposal):
    informations = [one.information for one in proposal.candidates]
    assert len(informations) == NUMBER
    steady = [one.information for one in proposal.candidates if one.amplification <= STEADY]
    assert informations == sorted(steady, reverse=True) + sorted(set(informations) - set(steady), reverse=True)
    assert informations[0] > 0.5
    # Friction is seen where the object coasts: more, the faster it is.
    speeds = np.array([one.motion.speed for one in proposal.candidates])
    assert np.corrcoef(speeds, informations)[0, 1] > 0.3


def test_pushes_that_amplify_a_start_aside_come_after_the_others(twin):
    seen = next_push(unsure(twin, 0.5), number=48, draws=4).candidates
    amplified = [one.amplification > STEADY for one in seen]
    assert any(amplified)
    assert amplified == sorted(amplified)
    for some in (False, True):
        informations = [one.information for one, is_so in zip(seen, amplified, strict=True) if is_so == some]
        assert informations == sorted(informations, reverse=True)
    assert min(one.amplification for one in seen) < 2.0


def test_amplification_does_not_depend_on_where_the_object_is(twin):
    """Half a degree about the world's origin would move the pusher by 9 mm there."""
    draws, far = unsure(twin, 0.5), torch.tensor([1.0, 0.0, 0.0], dtype=torch.float64)
    here, X_WO = next_push(draws, number=8, draws=4).candidates, start_of(twin)
    there = next_push(draws, number=8, draws=4, X_WO=X_WO._replace(p=X_WO.p + far)).candidates
    assert [one.amplification for one in there] == pytest.approx([one.amplification for one in here], abs=1e-3)


def test_no_push_goes_towards_the_camera(twin, proposal):
    eye = np.array([0.6, 0.0, 0.4])
    seen = next_push(unsure(twin, 0.5), number=NUMBER, draws=2, eye=eye)
    along = [one.motion.direction_W[0] for one in seen.candidates]
    assert max(along) < 0.55
    assert max(one.motion.direction_W[0] for one in proposal.candidates) > 0.55
    with pytest.raises(ParameterError, match=r"eye: got .*; allowed: 3 finite numbers, m"):
        next_push(unsure(twin, 0.5), number=NUMBER, draws=2, eye=eye[:2])


def test_what_is_known_asks_for_no_further_push(twin, proposal):
    known = next_push(unsure(twin, 1e-4), number=NUMBER, draws=8)
    assert known.is_good_enough
    assert known.candidates[0].information < 0.05 * proposal.candidates[0].information
    assert known.spread[0] < 0.1 * proposal.spread[0]
    strict = dataclasses.replace(known, tolerance=(1e-9, 1e-9))
    assert not strict.is_good_enough


def test_the_same_seed_proposes_the_same_push(twin, proposal):
    again = next_push(unsure(twin, 0.5), number=NUMBER, draws=8)
    assert [one.information for one in again.candidates] == [one.information for one in proposal.candidates]


def test_pushes_stay_in_the_box(twin):
    low, high = (-0.2, -0.06), (0.2, 0.06)
    found = next_push(unsure(twin, 0.5), number=3, draws=4, low=low, high=high)
    for one in found.candidates:
        ends = [one.motion.p_WP, one.motion.p_WP + one.motion.distance * one.motion.direction_W]
        assert all((low <= end[:2]).all() and (end[:2] <= high).all() for end in ends)
    with pytest.raises(ParameterError, match="a box with room"):
        next_push(unsure(twin, 0.5), number=1, draws=2, low=(0.0, 0.0), high=(0.01, 0.01))


def test_a_poke_is_chosen_for_the_friction_that_decides_a_flip(twin):
    unknown = unsure(twin, 0.3)
    pusher = 0.5 * np.exp(0.4 * np.random.default_rng(0).permutation(np.linspace(-1.5, 1.5, 16)))
    values = np.column_stack([unknown.draws.values, pusher])
    keep = [k for k, name in enumerate(unknown.draws.names) if name != "friction_pusher"] + [values.shape[1] - 1]
    names = [*(name for name in unknown.draws.names if name != "friction_pusher"), "friction_pusher"]
    wide = dataclasses.replace(twin.theta["friction_pusher"], value=0.5, interval=(0.25, 1.0))
    floor = dataclasses.replace(twin.theta["friction_floor"], value=0.2, interval=(0.15, 0.25))
    theta = {**twin.theta, "friction_pusher": wide, "friction_floor": floor}
    unknown = dataclasses.replace(unknown, draws=Draws(names, values[:, keep]), theta=theta)
    found = next_push(unknown, motion="poke", number=8, draws=8)
    assert found.deciding == "friction_pusher"
    ways = np.array([one.motion.direction_W for one in found.candidates])
    assert (ways[:, 2] > 0.2).all()
    told = np.array([one.remaining["friction_pusher"] for one in found.candidates])
    much = np.array([one.information for one in found.candidates])
    assert told[0] == told[much >= 0.5 * much.max()].min() < 0.9
    level = next_push(unknown, number=2, draws=4)
    assert level.deciding is None
    assert all(one.motion.direction_W[2] == 0.0 for one in level.candidates)
    near = {name: (0.95 * one.value, 1.05 * one.value) for name, one in theta.items()}
    sure = {name: dataclasses.replace(one, interval=near[name]) for name, one in theta.items()}
    assert deciding_friction(dataclasses.replace(unknown, theta=sure)) is None


def test_the_motion_is_that_of_the_capture_where_it_is_at_hand(twin, tmp_path):
    with pytest.warns(UserWarning, match="does not say which capture it is from; pushes are level; --motion poke"):
        assert filmed_motion(twin) == "push"
    folder = write_pushed_cube(tmp_path / "capture")
    capture = load_capture(folder)
    origin = Origin.of(capture, [read_episode(capture, capture.episode_names[0])])
    filmed = dataclasses.replace(twin, provenance=twin.provenance | origin.to_provenance())
    assert filmed_motion(filmed) == "push"
    log = folder / "episodes" / capture.episode_names[0] / "trajectory.csv"
    rows = list(csv.DictReader(log.open()))
    for k, row in enumerate(rows):
        row["pz"] = str(float(row["pz"]) + 0.01 * k / len(rows))
    with log.open("w") as file:
        writer = csv.DictWriter(file, rows[0].keys())
        writer.writeheader()
        writer.writerows(rows)
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        assert filmed_motion(filmed) == "poke"
        assert torch.equal(start_of(filmed).p, capture.object.X_WO.p)


def test_a_capture_that_is_gone_is_named_with_what_is_taken_instead(twin, tmp_path):
    capture = load_capture(write_pushed_cube(tmp_path / "capture"))
    origin = Origin.of(capture, [read_episode(capture, capture.episode_names[0])])
    filmed = dataclasses.replace(twin, provenance=twin.provenance | origin.to_provenance())
    (tmp_path / "capture").rename(tmp_path / "elsewhere")
    with pytest.warns(UserWarning, match=r"its capture cannot be read \(.*capture.*\); the object starts upright"):
        assert start_of(filmed).p.tolist() == [0.0, 0.0, 0.0]
    with pytest.warns(UserWarning, match=r"its capture cannot be read .*; pushes are level; --motion poke"):
        assert filmed_motion(filmed) == "push"


def test_a_twin_without_draws_is_refused(twin):
    with pytest.raises(ParameterError, match="has no draws"):
        next_push(twin)


def test_the_friction_that_the_draws_differ_in_is_what_it_tells_about(proposal):
    best, last = proposal.candidates[0], proposal.candidates[-1]
    assert list(best.remaining) == ["friction_floor"]
    assert best.remaining["friction_floor"] < 0.5
    assert best.remaining["friction_floor"] < last.remaining["friction_floor"] <= 1.0


def test_where_frame_and_centre_go_together_a_push_of_another_face_is_proposed(twin):
    """Draws that one push along x left: shifts along y of the log and of the centre of mass do the same to it."""
    number = 24
    z = np.random.default_rng(0).normal(size=number)
    values = {key: np.full(number, one.value) for key, one in twin.theta.items()}
    names = ["frame_x", "frame_y", "frame_yaw", "center_x", "center_y", "center_z"]
    values |= {name: np.zeros(number) for name in names} | {"frame_y": 0.004 * z, "center_y": 0.004 * z}
    draws = Draws(list(values), np.stack(list(values.values()), -1))
    found = next_push(dataclasses.replace(twin, draws=draws), number=24, draws=16)
    assert abs(np.degrees(found.confusion.angle) - 90.0) < 10.0
    best = found.candidates[0]
    assert best.remaining["frame"] == min(
        one.remaining["frame"]
        for one in found.candidates
        if one.amplification <= STEADY and one.information >= 0.5 * found.candidates[1].information
    )
    wide = {**twin.theta, "friction_pusher": dataclasses.replace(twin.theta["friction_pusher"], interval=(0.01, 9.0))}
    poke = next_push(dataclasses.replace(twin, draws=draws, theta=wide), motion="poke", number=2, draws=4)
    assert poke.confusion is not None
    assert poke.deciding is None  # the first one is chosen for the frame
    # Along x again nothing would be told; along y the push comes sooner or later by the frame.
    assert abs(best.motion.direction_W[1]) > 0.5
