from pathlib import Path

import pytest

from pinwm_drake import errors


@pytest.mark.parametrize(
    ("parts", "message"),
    [
        ({"allowed": "a folder"}, "a.csv: allowed: a folder"),
        ({"row": 3, "value": "nan", "allowed": "finite"}, "a.csv, row 3: got nan; allowed: finite"),
        ({"value": 0, "allowed": "1 or more"}, "a.csv: got 0; allowed: 1 or more"),
    ],
)
def test_input_error_composes_its_message(parts, message):
    error = errors.InputError(Path("a.csv"), **parts)
    assert str(error) == message
    assert (error.path, error.row, error.value) == ("a.csv", parts.get("row"), parts.get("value"))


def test_every_error_is_of_one_family():
    family = [kind for kind in vars(errors).values() if isinstance(kind, type)]
    assert len(family) > 5
    assert all(issubclass(kind, errors.PinwmError) for kind in family)
