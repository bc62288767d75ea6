# SPDX-License-Identifier: MIT
import pytest

from pinwm_drake.errors import InputError, ParameterError
from pinwm_drake.nearest import nearest


@pytest.mark.parametrize(
    ("error", "expected"),
    [
        (ParameterError("--kind: got stal images; allowed: white images, stale images"), "stale images"),
        (ParameterError("object: got 'push t'; allowed: flip_mug, push_t"), "push_t"),
        (ParameterError("object: got 'push t'; allowed: a file, or one of flip_mug, push_t"), "push_t"),
        (ParameterError("object: got flip the mug; allowed: flip_mug, push_t"), "flip_mug"),
        (ParameterError("--kind: got white imagse; allowed: white images, stale images"), "white images"),
        (ParameterError("object: got flip the white mug; allowed: flip_mug, push_t"), ""),
        (ParameterError("mesh: got push t and more words; allowed: push_t"), ""),
        (ParameterError("mass: got not a number; allowed: a number, a list"), ""),
        (
            InputError("/nowhere/push t", value="no such scenario", allowed="a file, or one of flip_mug, push_t"),
            "push_t",
        ),
        (ParameterError("--engine: got 'hydro'; allowed: twin, hydroelastic, point"), "hydroelastic"),
        (ParameterError("task: got 'pish'; allowed: flip, push"), "push"),
        (ParameterError("--engine: got 'TWIN'; allowed: twin, point"), "twin"),
        (ParameterError("--mesh: got a folder; allowed: a file"), ""),
        (ParameterError("--engine: got 'bullet'; allowed: twin, point"), ""),
        (ParameterError("--worlds: got 0; allowed: 1 to 64"), ""),
        (InputError("/", value="an unknown option 'wrlds'", allowed="twin, worlds, out"), "worlds"),
        (InputError("/", value='an unknown key "frction" under theta', allowed="mass, friction"), "friction"),
        (InputError("/", value='object = "mugg"', allowed="cube, mug"), "mug"),
        (InputError("/", value="object 'mugg'", allowed="cube, mug"), "mug"),
        (InputError("/", value="no episode '001'", allowed="0000, 0001"), "0001"),
        (ParameterError("--free: got 'fricton_floor'; allowed: mass, friction_floor, lift"), "friction_floor"),
        (
            InputError(
                "/nowhere/pusht",
                value="no such scenario",
                allowed="a file, a twin's folder, or one of flip_mug, push_t",
            ),
            "push_t",
        ),
    ],
)
def test_the_nearest_allowed_name_is_found(error, expected):
    assert nearest(error) == expected


@pytest.mark.parametrize(
    ("given", "expected"),
    [("twn/twin.yaml", "twin/twin.yaml"), ("twn/other", "twin"), ("twin/twin.yml", "twin/twin.yaml"), ("xyz", "")],
)
def test_the_nearest_path_is_found(tmp_path, given, expected):
    (tmp_path / "twin").mkdir()
    (tmp_path / "twin/twin.yaml").write_text("")
    found = nearest(InputError(tmp_path / given, value="no such file", allowed="a twin"))
    assert found == (str(tmp_path / expected) if expected else "")
    assert nearest(InputError(tmp_path / given, value="Is a directory", allowed="a file that can be written")) == ""
