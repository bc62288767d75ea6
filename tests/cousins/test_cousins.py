# SPDX-License-Identifier: MIT
import dataclasses
import json
import math
import shutil

import numpy as np
import pytest
import torch
from scipy.stats import kstest

from pinwm_drake.cousins.cousin import CousinDraw, draw_cousins
from pinwm_drake.cousins.io import hash_cousins as file_hash
from pinwm_drake.cousins.io import hash_twin, read_cousins, write_cousins
from pinwm_drake.cousins.theta import MOMENTS
from pinwm_drake.errors import InputError, ParameterError
from pinwm_drake.rendering.harmonics import Y0, harmonics
from pinwm_drake.rendering.surfels import Surfels
from pinwm_drake.twin.read import load_twin
from pinwm_drake.twin.rollout import twin_parameters, twin_scene
from pinwm_drake.twin.twin import THETA, Draws, Estimate
from pinwm_drake.twin.write import write_twin
from tests.rendering.scenes import cloud
from tests.twin.samples import cube_twin

UPRIGHT = torch.tensor([1.0, 0.0, 0.0, 0.0], dtype=torch.float64)
FIELDS = ("mass", "inertia", "friction", "restitution")


@pytest.fixture(scope="module")
def twin(tmp_path_factory):
    return cube_twin(tmp_path_factory.mktemp("twin"))


@pytest.fixture(scope="module")
def scene(twin):
    return twin_scene(twin, UPRIGHT)


def drawn(cousins, key):
    return np.array([cousin.theta[key] for cousin in cousins.members])


def with_theta(twin, **values):
    """The twin with other estimates: (value, interval) each."""
    changed = {key: Estimate(*pair, True, THETA[key]) for key, pair in values.items()}
    return dataclasses.replace(twin, theta=twin.theta | changed)


def with_sh(twin, sh):
    return dataclasses.replace(twin, surfels=dataclasses.replace(cloud(len(sh)), sh=sh))


def colours(sh, number=4000):
    """(number, N, 3), in random directions."""
    directions = torch.randn(number, 3, generator=torch.Generator().manual_seed(0), dtype=torch.float64)
    basis = harmonics(torch.nn.functional.normalize(directions, dim=-1), round(sh.shape[1] ** 0.5) - 1)
    return torch.einsum("dk,nkc->dnc", basis, sh.double()) + 0.5


def assert_bodies(theta):
    """No moment of (n, 3) is more than the other two together."""
    assert (theta > 0).all()
    assert (theta.sum(axis=1) >= 2 * theta.max(axis=1) * (1 - 1e-9)).all()


def test_theta_is_spread_evenly_over_its_ranges(twin):
    cousins = draw_cousins(twin, 400, 0.2, seed=3)
    for key in ("mass", "friction_floor", "friction_pusher", "restitution_pusher"):
        share = (drawn(cousins, key) / twin.theta[key].value - 0.8) / 0.4
        assert share.min() >= -1e-12
        assert share.max() <= 1 + 1e-12
        assert kstest(share, "uniform").pvalue > 1e-3
    assert (drawn(cousins, "restitution_floor") == 0).all()  # (1 +- delta) 0
    each = np.stack([drawn(cousins, key) for key in ("mass", "friction_floor", "friction_pusher", *MOMENTS)])
    assert np.abs(np.corrcoef(each) - np.eye(6)).max() < 0.25  # each by itself; 0.05 is the standard deviation of 0
    assert all(one.source == "delta" for one in cousins.draw.ranges.values())


@pytest.mark.parametrize("moments", [(1.0, 1.0, 2.0), (1.0, 1.0, 1e-4), (2.0, 1.5, 0.5), (1.0, 1.2, 0.9)])
@pytest.mark.parametrize("delta", [0.1, 0.9])
def test_every_cousin_is_a_body_that_can_be(twin, scene, moments, delta):
    # A plate, a thin rod, one at the edge, and a lump.
    values = {key: (1e-4 * moment, None) for key, moment in zip(MOMENTS, moments, strict=True)}
    cousins = draw_cousins(with_theta(twin, restitution_pusher=(0.95, None), **values), 60, delta)
    theta = np.stack([drawn(cousins, key) for key in MOMENTS], -1)
    assert_bodies(theta)
    assert (np.abs(theta / (1e-4 * np.array(moments)) - 1) <= delta + 1e-9).all()
    assert (theta.std(axis=0) > 0).all()
    assert drawn(cousins, "restitution_pusher").max() <= 1
    parameters = cousins.parameters(scene)
    parameters.check(scene.model)
    found = parameters.inertia[:, 0].diagonal(dim1=-2, dim2=-1).numpy()
    np.testing.assert_allclose(found, theta, rtol=1e-8)


def test_harmonics_are_spread_evenly_over_their_ranges(twin):
    # Greyish, so that no colour comes near to where it could not be displayed.
    grey = with_sh(twin, 0.2 * cloud(300).sh)
    (cousin,) = draw_cousins(grey, 1, 0.1).members
    assert cousin.moved == 0
    assert (grey.surfels.sh < 0).any()
    share = ((cousin.sh / grey.surfels.sh).double().flatten().numpy() - 0.9) / 0.2
    assert np.abs(share - 0.5).max() < 0.5 + 1e-5  # rounding of single precision
    assert kstest(share, "uniform").pvalue > 1e-3


@pytest.mark.parametrize("degree", [0, 1, 3])
def test_colours_stay_displayable_from_everywhere(twin, degree):
    sh = cloud(400, degree=degree).sh
    sh[:, 0] = 0.7 * sh[:, 0].sign() * 0.5 / Y0 + 0.3 * sh[:, 0]  # near black and near white
    vivid = with_sh(twin, sh)
    before = colours(sh)
    low, high = before.amin(0).clamp_max(0), before.amax(0).clamp_min(1)
    for delta in (0.1, 0.5):
        (cousin,) = draw_cousins(vivid, 1, delta).members
        after = colours(cousin.sh)
        beyond = torch.maximum(low - after, after - high).amax(0)
        # 6.9 % of half of what the colours span; see `colours.py`. The low and high seen here are as near to the true.
        assert (beyond <= 0.035 * (high - low)).all()
        assert 0.01 < cousin.moved < 0.9
        # Without moving any back, they go farther.
        factors = 1 + delta * (2 * torch.rand(sh.shape, generator=torch.Generator().manual_seed(1)) - 1)
        free = colours(sh * factors)
        assert torch.maximum(low - free, free - high).amax() > 3 * beyond.amax().clamp_min(1e-3)
        # What is moved back is still between the twin and its draw.
        assert ((cousin.sh / sh - 1).abs() <= delta + 1e-5).all()


def test_white_stays_white_or_gets_darker(twin):
    white = with_sh(twin, torch.full((500, 1, 3), 0.5 / Y0))
    (cousin,) = draw_cousins(white, 1).members
    shades = colours(cousin.sh, 1)[0]
    assert shades.max() < 1 + 1e-6
    assert 0.45 < (shades > 1 - 1e-6).double().mean() < 0.55
    assert cousin.moved == pytest.approx(float((shades > 1 - 1e-6).double().mean()))
    assert 0.949 < shades.min() < 0.96


def test_a_cousin_depends_on_seed_and_number_only(twin):
    few, many, draw = draw_cousins(twin, 2, seed=5), draw_cousins(twin, 7, seed=5), CousinDraw(twin, seed=5)
    for one, other in ((few[1], many[1]), (many[6], draw.cousin(6)), (many[0], draw.cousin(0))):
        assert one.theta == other.theta
        assert torch.equal(one.sh, other.sh)
    others = [many[2], draw_cousins(twin, 2, seed=6)[1], draw_cousins(twin, 1, seed=5)[0]]
    for other in others:
        assert other.theta != few[1].theta
        assert not torch.equal(other.sh, few[1].sh)
    # Its looks do not depend on how its theta is drawn.
    assert torch.equal(draw_cousins(twin, 2, seed=5, from_intervals=True)[1].sh, few[1].sh)


def test_without_delta_every_cousin_is_the_twin_bit_by_bit(twin, scene):
    for cousin in draw_cousins(twin, 3, 0.0).members:
        assert cousin.theta == {key: value.value for key, value in twin.theta.items()}
        assert torch.equal(cousin.sh, twin.surfels.sh)
        assert cousin.moved == 0
        expected, found = twin_parameters(twin, scene), cousin.parameters(scene)
        assert all(torch.equal(getattr(found, name), getattr(expected, name)) for name in FIELDS)


def test_parameters_and_colours_of_all(twin, scene):
    cousins = draw_cousins(twin, 3)
    parameters = cousins.parameters()
    parameters.check(scene.model)
    assert parameters.num_worlds == len(cousins) == 3
    assert parameters.friction.tolist() == [
        [one.theta["friction_floor"], one.theta["friction_pusher"]] for one in cousins.members
    ]
    assert torch.equal(parameters.mass[:, 0], torch.from_numpy(drawn(cousins, "mass")))
    assert cousins.sh().shape == (3, *twin.surfels.sh.shape)
    assert torch.equal(cousins.sh()[2], cousins[2].sh)


def test_identified_intervals_are_where_theta_is_drawn_from(twin):
    changed = with_theta(
        twin,
        mass=(1.0, None),
        friction_floor=(0.3, (0.29, 0.31)),
        friction_pusher=(0.2, (0.01, 1.5)),
        restitution_floor=(0.0, (-0.1, 0.6)),
        restitution_pusher=(0.5, (0.1, math.inf)),
        inertia_xx=(1.2e-4, (-math.inf, 1.25e-4)),
        inertia_yy=(1.2e-4, (0.0, 1.3e-4)),
        inertia_zz=(1.2e-4, (-math.inf, math.inf)),
    )
    cousins = draw_cousins(changed, 300, 0.1, from_intervals=True)
    expected = {
        "mass": (0.9, 1.1, "delta"),
        "friction_floor": (0.29, 0.31, "interval"),
        "friction_pusher": (0.01, 1.5, "interval"),
        "restitution_floor": (0.0, 0.6, "interval"),
        "restitution_pusher": (0.1, 0.55, "interval to delta"),
        "inertia_xx": (1.08e-4, 1.25e-4, "delta to interval"),
        "inertia_yy": (1.08e-4, 1.3e-4, "delta to interval"),  # a moment of 0 is none
        "inertia_zz": (1.08e-4, 1.32e-4, "delta"),
    }
    for key, (low, high, source) in expected.items():
        one, values = cousins.draw.ranges[key], drawn(cousins, key)
        assert (one.low, one.high) == pytest.approx((low, high), rel=1e-12)
        assert one.source == source
        assert one.low <= values.min() < low + 0.05 * (high - low)
        assert high - 0.05 * (high - low) < values.max() <= one.high
    assert {one.source for one in draw_cousins(changed, 1).draw.ranges.values()} == {"delta"}


def test_moments_follow_a_mass_that_the_video_leaves_open(twin):
    # Both intervals are those of one ratio.
    moments = dict.fromkeys(MOMENTS, (1.2e-4, (1.1e-4, 1.3e-4)))
    cousins = draw_cousins(with_theta(twin, mass=(0.2, (0.01, 4.0)), **moments), 100, from_intervals=True)
    mass = drawn(cousins, "mass")
    assert mass.max() / mass.min() > 10
    for key in MOMENTS:
        ratio = drawn(cousins, key) / mass * 0.2
        assert ratio.min() >= 1.1e-4 * (1 - 1e-9)
        assert ratio.max() <= 1.3e-4 * (1 + 1e-9)


def test_an_interval_that_no_body_has_ends_where_bodies_do(twin):
    # Each moment for itself may be; no triple of draws is.
    flat, tall = (1e-4, (1e-4, 1e-4)), (1e-4, (3e-4, 4e-4))
    values = dict(zip(MOMENTS, (flat, flat, tall), strict=True))
    cousins = draw_cousins(with_theta(twin, **values, mass=(0.2, None)), 20, from_intervals=True)
    theta = np.stack([drawn(cousins, key) for key in MOMENTS], -1)
    assert_bodies(theta)
    np.testing.assert_allclose(theta, np.tile([1e-4, 1e-4, 2e-4], (20, 1)), rtol=1e-9)


def test_a_file_gives_back_the_very_cousins(twin, tmp_path):
    cousins = draw_cousins(twin, 3, 0.2, seed=4, from_intervals=True)
    write_cousins(tmp_path / "cousins.npz", cousins)
    found = read_cousins(tmp_path / "cousins.npz", twin)
    assert [one.theta for one in found.members] == [one.theta for one in cousins.members]
    assert torch.equal(found.sh(), cousins.sh())
    assert [one.moved for one in found.members] == [one.moved for one in cousins.members]
    assert found.draw.ranges == cousins.draw.ranges
    further, expected = found.draw.cousin(9), cousins.draw.cousin(9)
    assert further.theta == expected.theta
    assert torch.equal(further.sh, expected.sh)
    assert [path.name for path in tmp_path.iterdir()] == ["cousins.npz"]


def test_a_twin_is_the_same_after_writing_and_in_another_place(twin, tmp_path):
    write_twin(tmp_path / "a", twin)
    shutil.copytree(tmp_path / "a", tmp_path / "b")
    shutil.rmtree(tmp_path / "a")
    copy = load_twin(tmp_path / "b")
    assert hash_twin(copy) == hash_twin(twin) == hash_twin(dataclasses.replace(twin, name="x", provenance={}))
    write_cousins(tmp_path / "c.npz", draw_cousins(twin, 1))
    assert read_cousins(tmp_path / "c.npz", copy)[0].twin().mesh_path == tmp_path / "b/meshes/object.obj"


def test_the_hash_is_that_of_version_0_1(twin, tmp_path):
    (tmp_path / "mesh.obj").write_bytes(b"mesh")
    surfels = Surfels(*(torch.zeros_like(tensor) for tensor in twin.surfels.tensors().values()))
    plain = dataclasses.replace(twin, mesh_path=tmp_path / "mesh.obj", surfels=surfels)
    assert hash_twin(plain) == "7e7628f6e61fe9c6bb0763429c4ed0f66826aa1dd163dde92310ae380f8b7ebb"


@pytest.mark.parametrize(
    "change",
    [
        lambda twin: with_theta(twin, friction_floor=(0.3 + 1e-9, twin.theta["friction_floor"].interval)),
        lambda twin: with_theta(twin, friction_floor=(0.3, None)),
        lambda twin: with_sh(twin, twin.surfels.sh.nextafter(torch.tensor(9.0))),
        lambda twin: dataclasses.replace(twin, surfels=cloud(61)),
        lambda twin: dataclasses.replace(twin, gravity=9.8),
    ],
)
def test_the_cousins_of_another_twin_are_refused(twin, tmp_path, change):
    write_cousins(tmp_path / "c.npz", draw_cousins(twin, 1))
    with pytest.raises(InputError, match=r"c.npz: got cousins of the twin [0-9a-f]{12}...; allowed: of .* \(cube\)"):
        read_cousins(tmp_path / "c.npz", change(twin))


def test_a_changed_or_broken_file_is_refused(twin, tmp_path):
    path = tmp_path / "c.npz"
    write_cousins(path, draw_cousins(twin, 2))
    with np.load(path) as file:
        arrays = dict(file)
    about = json.loads(str(arrays["about"]))

    def changed(name, value):
        return arrays | {name: value}

    def retold(**values):
        return changed("about", np.array(json.dumps(about | values)))

    theta, allowed = arrays["theta"].copy(), "allowed: cousins, as `pinwm cousins` writes them"
    theta[1, 4] *= 1.01
    for contents, message in (
        (changed("theta", theta), "got arrays with SHA-256 .*; allowed: .* as written"),
        (changed("sh", arrays["sh"][:, :, ::-1]), "got arrays with SHA-256"),
        (changed("theta", theta[:1]), "got arrays with SHA-256"),
        (retold(delta=0.3), "got contents that were changed"),
        (retold(seed=1), "got contents that were changed"),
        (retold(twin=hash_twin(with_theta(twin, mass=(1.0, None)))), "got contents that were changed"),
        (retold(version=1), f"got version 1 of something; {allowed}"),
        (retold(more=2), f"got version 2 of something; {allowed}"),
        ({"theta": theta}, f'no array "about"; {allowed}'),
        (changed("about", np.array("{")), "row 1: .*; allowed: JSON"),
        (changed("about", np.array("[1]")), r"got about = \[1\]"),
    ):
        np.savez(path, **contents)
        with pytest.raises(InputError, match=message) as caught:
            read_cousins(path, twin)
        assert str(caught.value).startswith(str(path))
    # Whoever can make the hash anew is still told what does not fit.
    for name, value in (("theta", theta.astype(np.float32)), ("theta", theta[0]), ("moved", theta), ("sh", theta)):
        values = {key: array for key, array in changed(name, value).items() if key != "about"}
        plain = {key: entry for key, entry in about.items() if not key.startswith("sha256")}
        np.savez(path, about=np.array(json.dumps(plain | {"sha256": file_hash(plain, values)})), **values)
        with pytest.raises(InputError, match=r"c.npz: got \w+ of float\d\d, .*; allowed: finite float\d\d of shape"):
            read_cousins(path, twin)
    write_cousins(path, draw_cousins(twin, 2))
    contents = path.read_bytes()
    for broken in (contents[:1000], b"", b"no archive", contents[:3000] + b"\x55" + contents[3001:]):
        path.write_bytes(broken)
        with pytest.raises(InputError, match=r"c.npz: got unreadable contents"):
            read_cousins(path, twin)
    with pytest.raises(InputError, match=r"none.npz: no such file"):
        read_cousins(tmp_path / "none.npz", twin)


def test_options_out_of_range_are_refused(twin):
    for options, message in (
        ({"n": 0}, "n: got 0; allowed: a whole number from 1"),
        ({"n": 1.5}, "n: got 1.5"),
        ({"n": True}, "n: got True"),
        ({"n": 1, "delta": 1.0}, "delta: got 1.0; allowed: 0 or more, less than 1"),
        ({"n": 1, "delta": -0.1}, "delta: got -0.1"),
        ({"n": 1, "delta": math.nan}, "delta: got nan"),
        ({"n": 1, "seed": -1}, "seed: got -1; allowed: a whole number, 0 or more"),
    ):
        with pytest.raises(ParameterError, match=message):
            draw_cousins(twin, **options)
    with pytest.raises(ParameterError, match="number: got -1"):
        CousinDraw(twin).cousin(-1)


def with_draws(twin, seed=0, number=300):
    """The twin with draws in which friction and spread of the pressure go up and down together."""
    z = np.random.default_rng(seed).normal(size=(number, 2))
    values = {key: np.full(number, one.value) for key, one in twin.theta.items()}
    values["friction_floor"] = 0.2 * np.exp(0.3 * z[:, 0])
    values["support_x"] = np.exp(0.3 * z[:, 0] + 0.03 * z[:, 1])
    for key in MOMENTS:
        values[key] = values[key] * np.exp(0.1 * z[:, 1])
    estimates = {
        key: (twin.theta[key].value, tuple(np.quantile(values[key], [0.025, 0.975])))
        for key in ("friction_floor", *MOMENTS)
    }
    draws = Draws(list(values), np.stack(list(values.values()), -1))
    return dataclasses.replace(with_theta(twin, **estimates, mass=(twin.theta["mass"].value, None)), draws=draws)


def test_what_was_identified_is_drawn_together(twin, scene):
    known = with_draws(twin)
    cousins = draw_cousins(known, 400, 0.1, from_intervals=True)
    friction, spread = drawn(cousins, "friction_floor"), np.array([cousin.shape["support_x"] for cousin in cousins])
    assert np.corrcoef(np.log(friction), np.log(spread))[0, 1] > 0.98
    assert set(friction) <= set(known.draws.column("friction_floor"))
    # A mass that was not identified moves by delta, and takes the moments with it: only their ratio was seen.
    mass, moment = drawn(cousins, "mass"), drawn(cousins, "inertia_zz")
    assert np.ptp(mass) > 0.15 * known.theta["mass"].value
    ratios = known.draws.column("inertia_zz") / known.theta["mass"].value
    assert np.abs((moment / mass)[:, None] - ratios).min(axis=1).max() < 1e-12
    parameters = cousins.parameters(scene)
    assert torch.equal(parameters.spread[:, 0, 0], torch.from_numpy(spread))
    # Without the flag nothing of it is drawn, and the nuisances are the twin's.
    plain = draw_cousins(known, 5)
    assert {cousin.shape["support_x"] for cousin in plain} == {1.0}


def test_cousins_from_draws_go_to_a_file_and_back(twin, tmp_path):
    known = with_draws(twin)
    cousins = draw_cousins(known, 3, from_intervals=True)
    write_cousins(tmp_path / "c.npz", cousins)
    again = read_cousins(tmp_path / "c.npz", known)
    assert [cousin.shape for cousin in again] == [cousin.shape for cousin in cousins]
    assert [cousin.theta for cousin in again] == [cousin.theta for cousin in cousins]
    with pytest.raises(InputError, match="cousins of the twin"):
        read_cousins(tmp_path / "c.npz", with_draws(twin, seed=1))
