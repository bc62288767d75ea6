# SPDX-License-Identifier: MIT
import dataclasses
import math
from pathlib import Path

import numpy as np
import pytest
import yaml

from pinwm_drake import documents
from pinwm_drake.errors import InputError, ParameterError
from pinwm_drake.geometry.meshes import load_mesh
from pinwm_drake.models import model_names, model_path
from pinwm_drake.systems.scenario.schema import ENGINES, Pusher, Scenario, Shape, Theta, load_scenario
from pinwm_drake.systems.scenario.setup import make_setup
from pinwm_drake.systems.scenario.start import StartDistribution

SHIPPED = [
    "push_t",
    "push_large_t",
    "push_cube",
    "push_cube_slippery",
    "push_mug",
    "flip_mug",
    "flip_mug_handle",
    "flip_cube",
]
URL = "package://pinwm_models/scenarios/{}.scenario.yaml"


def write(folder: Path, text: str) -> Path:
    path = folder / "some.scenario.yaml"
    path.write_text(text, encoding="utf-8")
    return path


def refusal(folder: Path, text: str) -> str:
    path = write(folder, text)
    with pytest.raises(InputError) as caught:
        load_scenario(path)
    assert str(caught.value).startswith(str(path))
    return str(caught.value)[len(str(path)) :]


@pytest.mark.parametrize("name", SHIPPED)
def test_scenarios_that_ship_are_found_by_their_url(name):
    scenario = load_scenario(URL.format(name))
    assert scenario.name == name
    assert scenario.engine in ENGINES
    assert scenario == load_scenario(model_path(f"scenarios/{name}.scenario.yaml"))


def test_friction_directions_are_accepted_with_one_warning(tmp_path, monkeypatch):
    monkeypatch.setattr(documents, "_warned", set())
    path = write(tmp_path, "object: mug\nphysics: {friction_directions: 8, support: corners}")
    with pytest.warns(FutureWarning, match=r"some.scenario.yaml: physics.friction_directions has no effect") as warned:
        scenarios = [load_scenario(path), load_scenario(path)]
    assert len(warned) == 1
    assert scenarios[0] == scenarios[1] == load_scenario(write(tmp_path, "object: mug\nphysics: {support: corners}"))


def test_all_scenarios_that_ship_are_tested():
    there = [path for path in model_names() if path.endswith(".scenario.yaml")]
    assert there == sorted(f"scenarios/{name}.scenario.yaml" for name in SHIPPED)


@pytest.mark.parametrize("name", SHIPPED)
def test_objects_of_shipped_scenarios_start_on_the_floor_with_the_pusher_in_its_box(name):
    setup = make_setup(load_scenario(URL.format(name)))
    low, high = np.array(setup.scenario.pusher.low), np.array(setup.scenario.pusher.high)
    starts, generator = StartDistribution(setup), np.random.default_rng(0)
    vertices = load_mesh(setup.twin.mesh_path).vertices
    for _ in range(50):
        place = starts.draw(generator)
        corners = vertices @ place.X_WO.rotation().matrix().T + place.X_WO.translation()
        assert corners[:, 2].min() == pytest.approx(0, abs=1e-12)
        assert (low < place.p_WP).all()
        assert (place.p_WP < high).all()
        # The pusher meets the object where it goes level, and does not touch it yet.
        assert place.p_WP[2] < corners[:, 2].max()
        assert np.linalg.norm((corners - place.p_WP)[:, :2], axis=1).min() > 0.01
    # Pixels of the camera show where objects may be.
    p_C = setup.X_WC.inverse() @ np.array([[0.08, 0.08, 0], [-0.08, 0.08, 0], [0.08, -0.08, 0], [-0.08, -0.08, 0]]).T
    assert (np.abs(p_C[:2] / p_C[2]) < math.tan(0.5 * setup.scenario.camera.fov_y)).all()


def test_a_further_try_begins_with_the_pusher_on_any_side_of_an_object_that_was_moved():
    setup = make_setup(load_scenario(URL.format("flip_mug")))
    low, high = np.array(setup.scenario.pusher.low), np.array(setup.scenario.pusher.high)
    starts, generator = StartDistribution(setup), np.random.default_rng(0)
    places = [starts.anywhere(generator)[0] for _ in range(200)]
    for place in places:
        corners = starts.vertices @ place.X_WO.rotation().matrix().T + place.X_WO.translation()
        assert corners[:, 2].min() == pytest.approx(0, abs=1e-12)
        assert (low <= place.p_WP).all()
        assert (place.p_WP <= high).all()
    away = np.array([place.p_WP - place.X_WO.translation() for place in places])
    base = np.array([-place.X_WO.rotation().matrix()[:, 2] for place in places])
    side = np.einsum("pi,pi->p", away[:, :2], base[:, :2]) / np.linalg.norm(away[:, :2], axis=1)
    assert np.histogram(np.arccos(side.clip(-1, 1)), 4, (0.0, math.pi))[0].min() > 25
    moved = np.array([place.X_WO.translation()[:2] for place in places])
    assert 0.15 < np.abs(moved).max() < 0.18
    draws = np.random.default_rng(1), np.random.default_rng(1)
    assert (starts.draw(draws[0]).p_WP == StartDistribution(setup).draw(draws[1]).p_WP).all()


def test_the_mug_of_flip_lies_on_a_facet_with_its_base_towards_the_pusher():
    setup = make_setup(load_scenario(URL.format("flip_mug")))
    place = StartDistribution(setup).middle()
    down_O = place.X_WO.rotation().matrix() @ [0, 0, -1.0]  # out of the base, world
    towards = (place.p_WP - place.X_WO.translation())[:2]
    np.testing.assert_allclose(down_O, [*(towards / np.linalg.norm(towards)), 0], atol=1e-12)
    heights = (load_mesh(setup.twin.mesh_path).vertices @ place.X_WO.rotation().matrix().T)[:, 2]
    assert (heights < heights.min() + 1e-9).sum() >= 4


def test_starts_of_flip_roll_over_facets_with_the_pusher_before_the_base():
    setup = make_setup(load_scenario(URL.format("flip_mug")))
    starts, vertices = StartDistribution(setup), load_mesh(setup.twin.mesh_path).vertices
    generator, rolls = np.random.default_rng(0), set()
    for _ in range(200):
        place = starts.draw(generator)
        R_WO = place.X_WO.rotation().matrix()
        heights = vertices @ R_WO[2]
        assert (heights < heights.min() + 1e-9).sum() >= 4  # a facet, not an edge
        down, towards = -R_WO[:2, 2], (place.p_WP - place.X_WO.translation())[:2]
        assert abs(np.linalg.det([down, towards / np.linalg.norm(towards)])) < math.sin(0.101)
        assert down @ towards > 0
        assert abs(math.atan2(down[1], -down[0])) < math.pi / 3 + 1e-9
        rolls.add(math.floor(math.atan2(R_WO[2, 1], R_WO[2, 0]) * 64 / (2 * math.pi)) % 64)
    assert len(rolls) > 55


def test_every_value_of_a_file_arrives(tmp_path):
    text = """
    name: mine
    object: cube
    engine: point
    theta: {mass: 2, friction_floor: 1e-1, friction_pusher: 0.3, restitution: 0.5}
    pusher: {shape: {kind: capsule, radius: 0.02, length: 0.05}, max_speed: 0.4, low: [-1, -2, -3], high: [1, 2, 3]}
    camera: {width: 64, p_WC: [0, 1, 2]}
    start: {x: [-0.1, 0.2]}
    num_worlds: 3
    seed: 18446744073709551
    """
    scenario = load_scenario(write(tmp_path, text))
    assert (scenario.name, scenario.object, scenario.engine) == ("mine", "cube", "point")
    assert scenario.theta == Theta(2.0, 0.1, 0.3, 0.5)
    assert scenario.pusher.shape == Shape("capsule", 0.02, 0.05)
    assert (scenario.pusher.max_speed, scenario.pusher.low, scenario.pusher.high) == (0.4, [-1, -2, -3], [1, 2, 3])
    assert (scenario.camera.width, scenario.camera.height, scenario.camera.p_WC) == (64, 128, [0, 1, 2])
    assert (scenario.start.x, scenario.start.y) == ([-0.1, 0.2], [0, 0])
    assert (scenario.num_worlds, scenario.seed) == (3, 18446744073709551)
    assert scenario.gravity is None


def test_a_scenario_with_what_was_left_out_written_down_is_the_same(tmp_path):
    short = load_scenario(write(tmp_path, "object: mug"))
    long = load_scenario(write(tmp_path, yaml.safe_dump(dataclasses.asdict(short))))
    assert short == long == Scenario(object="mug")


def test_lists_of_two_scenarios_are_not_shared():
    one, other = Scenario(object="mug"), Scenario(object="mug")
    one.start.x[0] = -1.0
    assert other.start.x == [0, 0]


@pytest.mark.parametrize(
    ("text", "message"),
    [
        # Unknown keys, at the top and below.
        ("object: mug\nfriction: 0.3", ': got an unknown key "friction"; allowed: units, name, object'),
        ("object: mug\ntheta: {friction: 0.3}", ': got an unknown key "friction" under theta; allowed: mass, '),
        ("object: mug\npusher: {shape: {size: 1}}", ': got an unknown key "size" under pusher.shape'),
        ("object: mug\n3: 4", ": got an unknown key 3"),
        # Other units.
        ("object: mug\nunits: {length: mm}", ': got units.length = "mm"; allowed: m'),
        ("object: mug\nunits: {angle: deg}", ': got units.angle = "deg"; allowed: rad'),
        ("object: mug\nunits: {force: N}", ': got an unknown key "force" under units'),
        ("object: mug\ncamera: {fov_y: 0.7 rad}", ': got camera.fov_y = "0.7 rad"; allowed: a number from 0.02 to 2.8'),
        # Wrong kinds.
        ("object: mug\ntheta: {mass: '1'}", ': got theta.mass = "1"; allowed: a number from 0.001 to 100 [kg]'),
        ("object: mug\ntheta: {mass: true}", ": got theta.mass = true"),
        ("object: mug\ntheta: {mass: [1]}", ": got theta.mass = [1]"),
        ("object: mug\ntheta: 3", ": got theta = 3; allowed: a mapping with keys"),
        ("object: mug\ntheta: {mass: }", ": got theta.mass = null"),
        ("object: mug\nstart: ", ": got start = null; allowed: a mapping with keys"),
        ("object: mug\nseed: 1.5", ": got seed = 1.5; allowed: a whole number from 0"),
        ("object: mug\nseed: '3'", ': got seed = "3"'),
        ("object: mug\nname: 3", ": got name = 3; allowed: text"),
        ("object: mug\nstart: {x: 0.1}", ": got start.x = 0.1; allowed: 2 finite numbers"),
        ("object: mug\nstart: {x: [0, 0, 0]}", ": got start.x = [0, 0, 0]; allowed: 2 finite numbers"),
        ("object: mug\ncamera: {p_WC: [0, 0, high]}", ': got camera.p_WC[2] = "high"; allowed: a finite number'),
        # Out of range.
        ("object: mug\ntheta: {friction_floor: -0.1}", ": got theta.friction_floor = -0.1; allowed: a number from 0"),
        ("object: mug\ntheta: {mass: .nan}", ": got theta.mass = NaN"),
        ("object: mug\ntheta: {mass: .inf}", ": got theta.mass = Infinity"),
        ("object: mug\npusher: {period: 0}", ": got pusher.period = 0; allowed: a number from 1e-05 to 1 [s]"),
        ("object: mug\npusher: {low: [0, 0, 0], high: [1, 1, 0]}", ": got pusher.low = [0, 0, 0]; allowed: below"),
        ("object: mug\npusher: {low: [0, 0, 2]}", ": got pusher.low = [0, 0, 2]; allowed: below `high`"),
        ("object: mug\npusher: {shape: {kind: sphere, length: 0.1}}", ": got pusher.shape.length = 0.1; allowed: a"),
        ("object: mug\npusher: {shape: {kind: cylinder}}", ": got pusher.shape = {"),
        ("object: mug\nstart: {yaw: [1, 0]}", ": got start.yaw = [1, 0]; allowed: [low, high]"),
        ("object: mug\nstart: {q_WO: [1, 1, 0, 0]}", ": got start.q_WO = [1, 1, 0, 0]; allowed: a quaternion"),
        ("object: mug\nnum_worlds: 0", ": got num_worlds = 0; allowed: a whole number from 1"),
        ("object: mug\ncamera: {p_WC: [1, 2, 1000]}", ": got camera.p_WC[2] = 1000; allowed: a number from -100"),
        ("object: mug\ncamera: {p_WC: [1, 2, 1], p_WT: [1, 2, 1]}", ": got camera.p_WT = [1, 2, 1]; allowed: "),
        ("object: mug\ncamera: {p_WC: [1, 2, 1], p_WT: [1, 2, 0]}", ": got camera.p_WT = [1, 2, 0]; allowed: "),
        ("object: teapot", ': got object = "teapot"; allowed: t_block, '),
        ("object: mug\nengine: bullet", ': got engine = "bullet"; allowed: twin, hydroelastic, point'),
        ("object: mug\nphysics: {support: legs}", ': got physics.support = "legs"; allowed: corners, patch'),
        # Object or twin.
        ("name: empty", ": got neither; allowed: either an object or a twin"),
        ("", ": got null; allowed: a mapping with keys"),
        ("- object: mug", ": got ["),
        ("object: mug\ntwin: here", ": got both; allowed: either an object or a twin"),
        ("twin: here\ntheta: {mass: 1}", ": got theta = {"),
        ("twin: nowhere", ": got twin = nowhere; allowed: the folder of a twin"),
        # No YAML.
        ("object: [mug", ", row 1: got "),
        ("object: mug\nobject: *no", ", row 2: got found undefined alias"),
        ("object: !!python/object:os.system mug", ", row 1: got could not determine a constructor"),
    ],
)
def test_what_is_wrong_is_named_with_file_and_key(tmp_path, text, message):
    found = refusal(tmp_path, text)
    assert found.startswith(message)


def test_a_file_that_is_missing_is_named(tmp_path):
    with pytest.raises(InputError, match=r"nothing\.scenario\.yaml.*a file that can be read"):
        load_scenario(tmp_path / "nothing.scenario.yaml")
    with pytest.raises(InputError, match=r"scenarios/nothing\.scenario\.yaml"):
        load_scenario(URL.format("nothing"))
    with pytest.raises(InputError, match="a file that can be read"):
        load_scenario(tmp_path)


def test_a_twins_folder_is_beside_the_file(tmp_path, monkeypatch):
    (tmp_path / "twin").mkdir()
    path = write(tmp_path, "twin: twin")
    monkeypatch.chdir(tmp_path.parent)
    assert Path(str(load_scenario(path).twin)) == tmp_path / "twin"


def test_a_scenario_made_in_python_is_checked_too():
    for scenario, key in [
        (Scenario(object="mug", theta=Theta(mass=-1.0)), "theta.mass"),
        (Scenario(object="mug", pusher=Pusher(low=[0.0, 0.0])), "pusher.low"),
        (Scenario(object="mug", num_worlds=0), "num_worlds"),
    ]:
        with pytest.raises(InputError, match=rf"push: got {key}"):
            make_setup(scenario)


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("object: mug\npusher: {period: 0.006}", r"pusher\.period: got 0\.006 s; allowed: "),
        ("object: mug\nplant: {time_step: 0.0003}", r"pusher\.period: got .* multiple of plant\.time_step, 0\.0003 s"),
    ],
)
def test_periods_that_do_not_divide_each_other_are_refused(tmp_path, text, message):
    with pytest.raises(ParameterError, match=message):
        make_setup(load_scenario(write(tmp_path, text)))
