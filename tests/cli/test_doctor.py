# SPDX-License-Identifier: MIT
import json

import pytest

from pinwm_drake.experiments import doctor
from pinwm_drake.experiments.doctor import Finding

WELL = Finding("cores", "ok", "2 of 2")
SLOW = Finding("kernels", "slow", "0 of 25 [compiled]", "wait once")
BROKEN = Finding("rendering", "broken", "no picture", "install libegl1")


@pytest.mark.parametrize(("findings", "code"), [((WELL, SLOW), 0), ((WELL, BROKEN), 1)])
def test_what_is_broken_sets_the_exit_code(pinwm, monkeypatch, findings, code):
    monkeypatch.setattr(doctor, "examine", lambda out: iter(findings))
    got, output, errors = pinwm("doctor")
    assert (got, errors) == (code, "")
    assert "ok      cores      2 of 2" in output
    assert f"{findings[1].name}: {findings[1].advice}" in output
    assert findings[1].found in output
    assert output.splitlines()[-1] == (
        "something that is needed does not work" if code else "everything that is needed works"
    )


def test_the_findings_are_json(pinwm, monkeypatch):
    monkeypatch.setattr(doctor, "examine", lambda out: iter((WELL, BROKEN)))
    code, output, _ = pinwm("doctor", "--json")
    assert code == 1
    found = json.loads(output)
    assert found["broken"] is True
    assert found["findings"][1] == {
        "name": "rendering",
        "status": "broken",
        "found": "no picture",
        "advice": "install libegl1",
    }
