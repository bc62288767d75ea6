# SPDX-License-Identifier: MIT
import yaml

from pinwm_drake.twin.write import write_twin
from tests.experiments.test_next_push import unsure
from tests.twin.samples import cube_twin


def test_a_push_is_proposed_anywhere_and_again_by_its_configuration(pinwm, tmp_path):
    write_twin(tmp_path / "twin", unsure(cube_twin(tmp_path), 0.5))
    options = ["--candidates", "2", "--draws", "2"]
    code, output, errors = pinwm("next-push", str(tmp_path / "twin"), "-o", str(tmp_path / "next"), *options)
    assert (code, errors) == (0, "")
    assert output.splitlines()[-1] == f"wrote {tmp_path / 'next/next_push.png'}"
    again = ["-o", str(tmp_path / "again"), "--config", str(tmp_path / "next/next-push.config.yaml")]
    assert pinwm("next-push", str(tmp_path / "twin"), *again)[0] == 0
    first, second = (yaml.safe_load((tmp_path / name / "push.yaml").read_text()) for name in ("next", "again"))
    assert first == second


def test_a_box_without_room_is_refused(pinwm, tmp_path):
    write_twin(tmp_path / "twin", unsure(cube_twin(tmp_path), 0.5))
    box = ["--low", "0.1", "0.1", "--high", "0", "0.2"]
    code, _, errors = pinwm("next-push", str(tmp_path / "twin"), "-o", str(tmp_path / "next"), *box)
    assert code == 1
    assert "--low, --high: got ((0.1, 0.1), (0.0, 0.2)); allowed: low below high" in errors
