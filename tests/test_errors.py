# SPDX-License-Identifier: MIT
from multiprocessing.reduction import ForkingPickler
from pathlib import Path

import pytest

from pinwm_drake import errors


@pytest.mark.parametrize(
    ("parts", "message"),
    [
        ({"allowed": "a folder"}, "a.csv: allowed: a folder"),
        ({"row": 3, "value": "nan", "allowed": "finite"}, "a.csv, row 3: got nan; allowed: finite"),
        ({"value": 0, "allowed": "1 or more"}, "a.csv: got 0; allowed: 1 or more"),
        ({"value": "no such file", "allowed": "a mesh"}, "a.csv: no such file; allowed: a mesh"),
        (
            {"value": "No such file or directory", "allowed": "a mesh"},
            "a.csv: no such file or directory; allowed: a mesh",
        ),
        ({"value": "normal", "allowed": "a mesh"}, "a.csv: got normal; allowed: a mesh"),
    ],
)
def test_input_error_composes_its_message(parts, message):
    error = errors.InputError(Path("a.csv"), **parts)
    assert str(error) == message
    assert (error.path, error.row, error.value) == ("a.csv", parts.get("row"), parts.get("value"))


def test_a_package_that_is_missing_is_named_with_its_extra():
    errors.require_package("pytest", "dev", "tests")
    message = "tests: no_such_package is not installed; run: pip install no_such_package "
    message += '(in a checkout: pip install -e ".[dev]")'
    with pytest.raises(errors.ParameterError) as caught:
        errors.require_package("no_such_package", "dev", "tests")
    assert str(caught.value) == message


def test_errors_can_be_sent_between_processes():
    # With the protocol of multiprocessing, which knows the arguments of an exception only.
    error = errors.InputError(Path("a.csv"), row=3, value=ValueError("x"), allowed="finite")
    sent = ForkingPickler.loads(ForkingPickler.dumps(error))
    assert str(sent) == str(error)
    assert (type(sent), sent.path, sent.row, sent.value, sent.allowed) == (errors.InputError, "a.csv", 3, "x", "finite")
    sent = ForkingPickler.loads(ForkingPickler.dumps(errors.SolverError("none", worlds=(1, 2))))
    assert (str(sent), sent.worlds) == ("none", (1, 2))


def test_every_error_is_of_one_family():
    family = [kind for kind in vars(errors).values() if isinstance(kind, type) and kind.__module__ == errors.__name__]
    assert len(family) > 5
    assert all(issubclass(kind, errors.PinwmError) for kind in family)
