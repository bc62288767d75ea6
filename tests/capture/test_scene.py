# SPDX-License-Identifier: MIT
import numpy as np
import pytest
import yaml

from pinwm_drake.capture.pusher import pusher_surface
from pinwm_drake.capture.scene import PusherGeometry, PusherShape, load_capture, read_capture_object
from pinwm_drake.errors import GeometryError, InputError
from tests.capture.cube import HEIGHT, write_mesh
from tests.capture.pushed_cube import RADIUS


def edit(folder, change):
    path = folder / "capture.yaml"
    document = yaml.safe_load(path.read_text())
    change(document)
    path.write_text(yaml.safe_dump(document))


def test_a_capture_is_read(pushed_cube):
    (pushed_cube / "episodes/another").mkdir()
    (pushed_cube / "episodes/.hidden").mkdir()
    (pushed_cube / "episodes/note.txt").write_text("hello")
    capture = load_capture(pushed_cube)
    assert capture.folder == pushed_cube
    assert (capture.object.name, capture.object.mass) == ("cube", 0.2)
    assert capture.object.X_WO.p.tolist() == [0, 0, HEIGHT]
    assert capture.object.mesh_path == pushed_cube / "meshes/object.obj"
    assert capture.pusher.shape == PusherShape("sphere", RADIUS, 0.0)
    assert capture.pusher.mesh_path is None
    assert (capture.floor_height, capture.gravity) == (0.0, 9.81)
    assert capture.episode_names == ["0000", "another"]


def test_a_pusher_is_a_mesh_or_a_shape(pushed_cube):
    write_mesh(pushed_cube / "meshes/pusher.obj")
    edit(pushed_cube, lambda d: d.update(pusher={"mesh": "meshes/pusher.obj", "shape": None}))
    pusher = load_capture(pushed_cube).pusher
    assert (pusher.mesh_path, pusher.shape) == (pushed_cube / "meshes/pusher.obj", None)
    assert pusher_surface(pusher).bounds[1].tolist() == [0.03, 0.03, 0.03]
    edit(pushed_cube, lambda d: d["pusher"].update(shape={"kind": "capsule", "radius": 0.01, "length": 0.1}))
    pusher = load_capture(pushed_cube).pusher
    # The shape wins: its bounds are those of a capsule along z.
    assert pusher_surface(pusher).bounds[1] == pytest.approx([0.01, 0.01, 0.06], abs=1e-12)
    edit(pushed_cube, lambda d: d["pusher"].update(shape={"kind": "cylinder", "radius": 0.01, "length": 0.1}))
    assert pusher_surface(load_capture(pushed_cube).pusher).bounds[1] == pytest.approx([0.01, 0.01, 0.05], abs=1e-12)


@pytest.mark.parametrize("kind", ["sphere", "cylinder", "capsule"])
def test_pusher_surfaces_are_closed_and_of_the_right_size(kind):
    surface = pusher_surface(PusherGeometry(None, PusherShape(kind, 0.01, 0.0 if kind == "sphere" else 0.06)))
    assert surface.is_watertight
    assert surface.volume > 0
    height = {"sphere": 0.02, "cylinder": 0.06, "capsule": 0.08}[kind]
    np.testing.assert_allclose(
        surface.bounds, 0.5 * np.array([[-0.02, -0.02, -height], [0.02, 0.02, height]]), rtol=1e-2
    )


def test_a_capture_without_episodes_needs_no_pusher(pushed_cube):
    (pushed_cube / "episodes").rename(pushed_cube / "elsewhere")
    edit(pushed_cube, lambda d: d.update(pusher={"mesh": None, "shape": None}))
    capture = load_capture(pushed_cube)
    assert capture.episode_names == []
    with pytest.raises(GeometryError, match="neither a mesh nor a shape"):
        pusher_surface(capture.pusher)


def test_mass_may_be_unknown(pushed_cube):
    edit(pushed_cube, lambda d: d["object"].update(mass=None))
    assert read_capture_object(pushed_cube).mass is None
    edit(pushed_cube, lambda d: d["object"].pop("mass"))
    assert load_capture(pushed_cube).object.mass is None


@pytest.mark.parametrize(
    ("change", "parts"),
    [
        (lambda d: d.update(schema_version=2), ["schema_version = 2", "allowed: 1"]),
        (lambda d: d.update(schema_version="1"), ['schema_version = "1"']),
        (lambda d: d.pop("schema_version"), ["no schema_version"]),
        (lambda d: d.update(units={"length": "mm"}), ['units.length = "mm"']),
        (lambda d: d.update(units={"mass": "kg"}), ['an unknown key "mass" under units']),
        (lambda d: d.update(colour="red"), ['an unknown key "colour"', "schema_version, units, gravity"]),
        (lambda d: d["object"].update(weight=2), ['an unknown key "weight" under object']),
        (lambda d: d["object"].update(mass=0), ["object.mass = 0", "1e-06"]),
        (lambda d: d["object"].update(mass=float("nan")), ["object.mass = NaN"]),
        (lambda d: d["object"].update(name=3), ["object.name = 3", "text"]),
        (lambda d: d["object"].update(name="a\nb"), ["object.name", "text"]),
        (lambda d: d["object"].update(mesh="meshes"), ["meshes", "a folder", "capture.yaml names"]),
        (lambda d: d["object"]["X_WO"].update(p=[0, 0, 1e6]), ["object.X_WO.p", "within 1000 m"]),
        (lambda d: d["object"]["X_WO"].update(q=[2, 0, 0, 0]), ["object.X_WO.q", "norm 2"]),
        (lambda d: d["object"]["X_WO"].update(x=1), ['an unknown key "x" under object.X_WO']),
        (lambda d: d.pop("gravity"), ["no gravity"]),
        (lambda d: d.update(gravity=-9.8), ["gravity = -9.8"]),
        (lambda d: d.update(floor=0.0), ["floor = 0.0", "a mapping"]),
        (lambda d: d.update(floor={"height": 0, "tilt": 1}), ['"tilt" under floor']),
        (lambda d: d.pop("pusher"), ["no pusher"]),
        (lambda d: d.update(pusher={"mesh": None, "shape": None}), ["pusher = ", "a mesh or a shape"]),
        (lambda d: d.update(pusher={"mesh": "nothing.obj"}), ["nothing.obj", "no such file"]),
        (lambda d: d["pusher"]["shape"].update(kind="cube"), ['kind = "cube"', "sphere, capsule, cylinder"]),
        (lambda d: d["pusher"]["shape"].update(kind=["sphere"]), ["kind = ['sphere']"]),
        (lambda d: d["pusher"]["shape"].update(radius=0), ["pusher.shape.radius = 0"]),
        (lambda d: d["pusher"]["shape"].update(length=0.1), ["pusher.shape.length = 0.1", "for a sphere"]),
        (lambda d: d["pusher"]["shape"].update(kind="capsule", length=-1), ["pusher.shape.length = -1"]),
        (lambda d: d["pusher"]["shape"].update(height=1), ['"height" under pusher.shape']),
    ],
)
def test_wrong_captures_are_refused(pushed_cube, change, parts):
    edit(pushed_cube, change)
    with pytest.raises(InputError) as caught:
        load_capture(pushed_cube)
    for part in parts:
        assert part in str(caught.value)
    assert "\n" not in str(caught.value)


def test_the_released_capture_is_read(shared):
    capture = load_capture(shared / "data/pinwm_push_t")
    assert capture.object.mass is None
    assert capture.episode_names == ["0000"]
    assert capture.pusher.shape is None
    assert pusher_surface(capture.pusher).is_watertight
