# SPDX-License-Identifier: MIT
from pinwm_drake.twin.write import write_twin
from tests.twin.samples import cube_twin


def test_a_twin_is_written_as_models(pinwm, tmp_path):
    write_twin(tmp_path / "twin", cube_twin(tmp_path))
    code, output, errors = pinwm("model", str(tmp_path / "twin"), str(tmp_path / "out"))
    assert (code, errors) == (0, "")
    names = ["object.sdf", "object_point.sdf", "floor.sdf", "pusher.sdf"]
    wrote = "".join(f"wrote {tmp_path / 'out' / name}\n" for name in names)
    assert output == "the object acts as its mesh\n" + wrote
    assert all((tmp_path / "out" / name).is_file() for name in names)


def test_a_folder_that_is_no_twin_is_refused(pinwm, tmp_path):
    code, output, errors = pinwm("model", str(tmp_path / "no"), str(tmp_path / "out"))
    assert (code, output) == (1, "")
    assert errors.startswith(f"pinwm: {tmp_path / 'no'}: no such folder; allowed: a twin")
    assert not (tmp_path / "out").exists()
