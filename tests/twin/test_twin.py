# SPDX-License-Identifier: MIT
import math
import random
import shutil
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import torch
import yaml

from pinwm_drake import documents
from pinwm_drake.capture.scene import PusherGeometry, PusherShape
from pinwm_drake.errors import InputError, ParameterError, RenderingError
from pinwm_drake.geometry.primitive import Primitive
from pinwm_drake.twin.read import load_twin
from pinwm_drake.twin.twin import THETA, Draws, Estimate, Twin
from pinwm_drake.twin.write import write_twin
from tests.capture.cube import write_mesh
from tests.twin.samples import cube_twin, estimates

SHAPE = PusherShape("cylinder", 0.02, 0.05)


@pytest.fixture
def folder(tmp_path) -> Path:
    """A twin with meshes for both, on disk."""
    pusher = PusherGeometry(write_mesh(tmp_path / "source/pusher.obj"), None)
    write_twin(tmp_path / "twin", cube_twin(tmp_path / "source", pusher=pusher))
    return tmp_path / "twin"


def change(folder: Path, place: str, value: object) -> None:
    """Puts a value at a place such as theta.mass.value into twin.yaml; "delete" takes the key away."""
    document = yaml.safe_load((folder / "twin.yaml").read_text())
    *parents, last = place.split(".")
    here = document
    for key in parents:
        here = here[key]
    if value == "delete":
        del here[last]
    else:
        here[last] = value
    (folder / "twin.yaml").write_text(yaml.safe_dump(document, sort_keys=False))


def assert_same(found: Twin, given: Twin) -> None:
    for name in ("name", "gravity", "floor_height", "time_step", "support", "theta", "acts_as"):
        assert getattr(found, name) == getattr(given, name)
    assert found.nuisance == given.nuisance
    assert found.camera_offset == given.camera_offset
    assert found.provenance == given.provenance
    assert found.pusher.shape == given.pusher.shape
    assert found.mesh_path.read_bytes() == given.mesh_path.read_bytes()
    for name, value in given.surfels.tensors().items():
        assert torch.equal(found.surfels.tensors()[name], value)


@pytest.mark.parametrize("pusher", ["mesh", "shape", "both"])
def test_a_twin_comes_back_as_it_was(tmp_path, pusher):
    mesh = None if pusher == "shape" else write_mesh(tmp_path / "source/elsewhere.obj")
    given = cube_twin(
        tmp_path / "source",
        name="Würfel: #1 {{title}}",
        pusher=PusherGeometry(mesh, None if pusher == "mesh" else SHAPE),
        nuisance={"lift": Estimate(1e-22, (-math.inf, math.inf), False, "m"), "x": Estimate(1.0, None, True, "")},
        acts_as=(
            Primitive("cylinder", (0.04, 0.08), (0.0, 1.0, 0.0, 0.0), (0.0, 0.0, 6e-3), 4.8e-5, (False, True)),
            Primitive("sphere", (0.01,)),
        ),
        provenance={"text": "1e3", "date": "2026-11-21", "yes": "yes", "nested": {"list": [1, 2.5, None, {"a": []}]}},
    )
    write_twin(tmp_path / "twin", given)
    found = load_twin(tmp_path / "twin")
    assert_same(found, given)
    assert (found.pusher.mesh_path is None) == (mesh is None)
    # What was read can be written again, over itself too.
    write_twin(tmp_path / "twin", found)
    assert_same(load_twin(tmp_path / "twin"), given)
    assert not list((tmp_path / "twin").rglob(".*"))


def test_a_mesh_that_a_shape_replaces_need_not_be_there(tmp_path):
    write_twin(tmp_path / "twin", cube_twin(tmp_path, pusher=PusherGeometry(tmp_path / "none.obj", SHAPE)))
    pusher = load_twin(tmp_path / "twin").pusher
    assert (pusher.mesh_path, pusher.shape) == (None, SHAPE)


def test_provenance_becomes_plain_data(tmp_path):
    about = {
        "losses": np.array([1.5, np.nan]),
        "path": Path("a/b"),
        "seed": np.int64(3),
        "pair": (1, math.inf),
        "by": {0: 1.5},
    }
    write_twin(tmp_path / "twin", cube_twin(tmp_path, provenance=about))
    plain = {"losses": [1.5, None], "path": "a/b", "seed": 3, "pair": [1, None], "by": {"0": 1.5}}
    assert load_twin(tmp_path / "twin").provenance == plain


def test_friction_directions_are_accepted_with_one_warning_and_not_written(tmp_path, monkeypatch):
    monkeypatch.setattr(documents, "_warned", set())
    given = cube_twin(tmp_path)
    write_twin(tmp_path / "twin", given)
    assert "friction_directions" not in (tmp_path / "twin/twin.yaml").read_text()
    change(tmp_path / "twin", "physics.friction_directions", 5)
    with pytest.warns(FutureWarning, match=r"twin.yaml: physics.friction_directions has no effect") as warned:
        twins = [load_twin(tmp_path / "twin") for _ in range(2)]
    assert len(warned) == 1
    for twin in twins:
        assert (twin.time_step, twin.support, twin.theta) == (given.time_step, given.support, given.theta)


def test_a_twin_that_makes_no_sense_is_not_written(tmp_path):
    for fields, message in (
        (
            {"theta": estimates(mass=-1.0)},
            "theta.mass.value = -1.0; allowed: above 0",
        ),
        ({"theta": estimates(friction_floor=math.nan)}, "theta.friction_floor.value = NaN; allowed: a finite number"),
        ({"theta": estimates() | {"color": estimates()["mass"]}}, 'an unknown key "color" under theta'),
        ({"theta": {"mass": estimates()["mass"]}}, "no theta.inertia_xx"),
        ({"pusher": PusherGeometry(None, None)}, "pusher = .*; allowed: a mesh or a shape"),
        ({"time_step": 0.0}, "physics.time_step = 0.0; allowed: above 0"),
        ({"provenance": {"thing": object()}}, "provenance.thing"),
        ({"mesh_path": tmp_path / "no.obj"}, "no.obj: no such file"),
    ):
        with pytest.raises(InputError, match=message):
            write_twin(tmp_path / "twin", cube_twin(tmp_path, **fields))
    surfels = cube_twin(tmp_path).surfels
    with pytest.raises(RenderingError, match="q_OS"):
        write_twin(tmp_path / "twin", cube_twin(tmp_path, surfels=replace(surfels, q_OS=0 * surfels.q_OS)))
    assert not (tmp_path / "twin").exists()


@pytest.mark.parametrize(
    ("place", "value", "message"),
    [
        ("schema_version", 2, "schema_version = 2; allowed: 1, the version"),
        ("schema_version", True, "schema_version = true; allowed: 1, the version"),
        ("units.length", "mm", 'units.length = "mm"; allowed: m'),
        ("units.mass", "delete", "no units.mass"),
        ("name", "", 'name = ""; allowed: text'),
        ("gravity", math.nan, "gravity = NaN; allowed: a finite number"),
        ("gravity", "9.8 m/s2", "gravity = .*; allowed: a finite number"),
        ("floor.height", math.inf, "floor.height = Infinity; allowed: a finite number"),
        ("physics.time_step", -0.1, "physics.time_step = -0.1"),
        ("physics.support", "feet", 'physics.support = "feet"; allowed: corners, patch or faces'),
        ("physics.solver", "fast", 'an unknown key "solver" under physics'),
        ("colour", "red", 'an unknown key "colour"'),
        ("theta", [1, 2], "theta = .*; allowed: a mapping"),
        ("theta.mass.value", -0.1, "theta.mass.value = -0.1; allowed: above 0"),
        ("theta.mass.value", None, "theta.mass.value = null; allowed: a finite number"),
        ("theta.mass.unit", "g", 'theta.mass.unit = "g"; allowed: "kg"'),
        ("theta.mass.std", 0.1, 'an unknown key "std" under theta.mass'),
        ("theta.mass", "delete", "no theta.mass"),
        ("theta.friction_floor.value", -0.01, "theta.friction_floor.value = -0.01; allowed: .* from 0"),
        ("theta.restitution_floor.value", 1.01, "theta.restitution_floor.value = 1.01; allowed: .* from 0 to 1"),
        ("theta.inertia_zz.value", 1.0, "theta.inertia_zz.value = 1.0; allowed: at most 0.00024, the sum"),
        ("theta.mass.interval", [2.0, 1.0], "theta.mass.interval = .*; allowed: null, or two numbers .low, high."),
        ("theta.mass.interval", [1.0], "theta.mass.interval = .*; allowed: null, or two numbers"),
        ("theta.mass.interval", [math.nan, 1.0], r"theta.mass.interval\[0\] = NaN; allowed: a finite number"),
        ("theta.mass.identifiable", "yes", "theta.mass.identifiable = .*; allowed: true or false"),
        ("theta.mass.note", "delete", "no theta.mass.note"),
        ("nuisance.lift.value", math.nan, "nuisance.lift.value = NaN"),
        ("nuisance", {1: 2}, "nuisance = .*; allowed: a mapping whose keys are text"),
        ("camera_offset", [0.0], "camera_offset = .*; allowed: 2 finite numbers"),
        ("provenance", "me", "provenance = .*; allowed: a mapping"),
        ("provenance.loss", math.nan, "provenance.loss = NaN; allowed: a finite number"),
        ("provenance.seeds", [0, [math.inf]], r"provenance.seeds\[1\]\[0\] = Infinity; allowed: a finite number"),
        ("pusher.shape", {"kind": "box", "radius": 1.0, "length": 1.0}, 'pusher.shape.kind = "box"; allowed: sphere'),
        ("pusher.mesh", None, "pusher = .*; allowed: a mesh or a shape"),
        ("mesh", "../source/cube.obj", "mesh = .*; allowed: a file in the folder of the twin"),
        ("mesh", "/etc/passwd", "mesh = .*; allowed: a file in the folder of the twin"),
        ("pusher.mesh", "..\\pusher.obj", "pusher.mesh = .*; allowed: a file in the folder of the twin"),
        ("mesh", "meshes/none.obj", "meshes/none.obj: no such file; allowed: the file that twin.yaml names"),
        ("sha256", "delete", "no sha256"),
        ("sha256", {}, "no sha256.meshes/object.obj"),
        ("sha256", {"other.obj": "00"}, 'an unknown key "other.obj" under sha256'),
    ],
)
def test_a_wrong_twin_is_refused(folder, place, value, message):
    change(folder, place, value)
    with pytest.raises(InputError, match=message) as caught:
        load_twin(folder)
    assert str(caught.value).startswith(str(folder))


def test_a_link_out_of_the_folder_is_refused(folder, tmp_path):
    (folder / "meshes/object.obj").unlink()
    (folder / "meshes/object.obj").symlink_to(tmp_path / "source/cube.obj")
    with pytest.raises(InputError, match=r"mesh = .*; allowed: a file in the folder of the twin"):
        load_twin(folder)


@pytest.mark.parametrize("name", ["surfels.ply", "meshes/object.obj", "meshes/pusher.obj"])
def test_a_changed_or_missing_file_is_refused(folder, name):
    path = folder / name
    contents = bytearray(path.read_bytes())
    contents[-2] ^= 1
    path.write_bytes(contents)
    with pytest.raises(InputError, match=f"{name}: got SHA-256 [0-9a-f]{{12}}...; allowed: .* the file was changed"):
        load_twin(folder)
    path.unlink()
    with pytest.raises(InputError, match=f"{name}: no such file"):
        load_twin(folder)


@pytest.mark.parametrize("interrupted", ["surfels.ply", "object.obj", "pusher.obj", "twin.yaml"])
def test_a_run_that_is_killed_leaves_the_earlier_twin_or_none(folder, tmp_path, monkeypatch, interrupted):
    earlier = load_twin(folder)
    other = cube_twin(tmp_path / "source", name="other", pusher=PusherGeometry(tmp_path / "source/2.obj", None))
    other = replace(other, surfels=replace(other.surfels, p_OS=other.surfels.p_OS + 0.01))
    (tmp_path / "source/2.obj").write_text("# another\n" + (tmp_path / "source/pusher.obj").read_text())
    rename = Path.replace

    class Killed(BaseException):
        pass

    def stop(self: Path, target: Path) -> Path:
        if target.name == interrupted:
            raise Killed
        return rename(self, target)

    monkeypatch.setattr(Path, "replace", stop)
    with pytest.raises(Killed):
        write_twin(folder, other)
    monkeypatch.undo()
    if interrupted == "surfels.ply":
        assert_same(load_twin(folder), earlier)
    else:
        with pytest.raises(InputError, match="SHA-256"):
            load_twin(folder)
    write_twin(folder, other)
    assert load_twin(folder).name == "other"


def test_folders_that_are_no_twins_are_refused(folder, tmp_path):
    for path, message in ((tmp_path / "nowhere", "no such folder"), (tmp_path, "twin.yaml: no such file")):
        with pytest.raises(InputError, match=message):
            load_twin(path)
    text = (folder / "twin.yaml").read_text()
    broken = {
        "theta: [": "allowed: YAML",
        "": "allowed: a mapping",
        "- 1": "allowed: a mapping",
        text.replace("provenance:", "provenance:\n  self: &a {b: *a}"): "more than 64 levels",
        text.replace("provenance:", "provenance:\n  when: 2026-11-21"): "provenance.when",
        text.replace("provenance:", "provenance:\n  1: 2"): "keys that are text",
        text.replace("provenance:", "provenance:\n  x: !!python/object:os.system {}"): "allowed: YAML",
    }
    for contents, message in broken.items():
        (folder / "twin.yaml").write_text(contents)
        with pytest.raises(InputError, match=message):
            load_twin(folder)


def test_damaged_text_never_ends_in_another_error(folder):
    """Bytes of twin.yaml are changed, lost and doubled at random: either a whole twin is read, or it is refused."""
    contents, generator, refused = (folder / "twin.yaml").read_bytes(), random.Random(0), 0
    for _ in range(150):
        damaged = bytearray(contents)
        for _ in range(generator.randint(1, 4)):
            at = generator.randrange(len(damaged))
            kind = generator.randrange(4)
            if kind == 0:
                damaged[at] = generator.randrange(256)
            elif kind == 1:
                del damaged[at : at + generator.randint(1, 30)]
            elif kind == 2:
                damaged[at:at] = damaged[at : at + generator.randint(1, 30)]
            else:
                damaged[at:at] = generator.choice(
                    [b"-", b"nan", b"1e999", b"\n", b"[", b"&a ", b"*a ", b"!!set ", b": "]
                )
        (folder / "twin.yaml").write_bytes(damaged)
        try:
            twin = load_twin(folder)
        except InputError:
            refused += 1
        else:
            assert set(twin.theta) == set(THETA)
            assert all(math.isfinite(estimate.value) for estimate in twin.theta.values())
            assert twin.theta["mass"].value > 0
    assert refused > 50


def test_a_copy_elsewhere_is_the_same_twin(folder, tmp_path):
    shutil.copytree(folder, tmp_path / "copy")
    twin = load_twin(folder)
    shutil.rmtree(folder)
    copy = load_twin(tmp_path / "copy")
    assert copy.theta == twin.theta
    assert copy.mesh_path == tmp_path / "copy/meshes/object.obj"


def test_other_values_of_theta_leave_the_shape_and_take_the_draws(tmp_path):
    twin = cube_twin(tmp_path)
    twin = replace(twin, draws=Draws(["mass"], np.ones((2, 1))))
    changed = twin.with_theta(mass=2 * twin.theta["mass"].value, friction_floor=0.25)
    assert changed.theta["friction_floor"].value == 0.25
    assert changed.theta["friction_floor"].interval is None
    for name in ("mass", "inertia_xx", "inertia_yy", "inertia_zz"):
        assert changed.theta[name].value == pytest.approx(2 * twin.theta[name].value)
    assert changed.theta["friction_pusher"] == twin.theta["friction_pusher"]
    assert changed.draws is None
    # Moments that are given are not scaled.
    assert twin.with_theta(mass=9.0, inertia_xx=1e-3).theta["inertia_yy"] == twin.theta["inertia_yy"]
    assert twin.with_theta().draws is twin.draws
    with pytest.raises(ParameterError, match=r"theta: got 'friction'; allowed: mass, "):
        twin.with_theta(friction=0.1)


@pytest.mark.parametrize(
    ("key", "value", "says"),
    [
        ("kind", "cone", "acts_as"),
        ("size", [0.04], "2 sizes"),
        ("size", [0.04, -0.08], "positive length"),
        ("q", [1.0, 1.0, 0.0, 0.0], "rotation matrix"),
    ],
)
def test_a_primitive_that_is_none_is_refused(tmp_path, key, value, says):
    given = cube_twin(tmp_path / "source", acts_as=(Primitive("cylinder", (0.04, 0.08)),))
    write_twin(tmp_path / "twin", given)
    document = yaml.safe_load((tmp_path / "twin/twin.yaml").read_text())
    document["acts_as"][0][key] = value
    (tmp_path / "twin/twin.yaml").write_text(yaml.safe_dump(document))
    with pytest.raises(InputError, match=says):
        load_twin(tmp_path / "twin")


def test_a_twin_from_before_primitives_acts_as_its_mesh(folder):
    change(folder, "acts_as", "delete")
    assert load_twin(folder).acts_as == ()
