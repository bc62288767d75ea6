# SPDX-License-Identifier: MIT
import numpy as np
import pytest

from pinwm_drake.capture.episode_tables import read_table
from pinwm_drake.errors import InputError

COLUMNS = ("t", "qw", "qx", "qy", "qz")


def table(tmp_path, text, optional=(), **options):
    path = tmp_path / "table.csv"
    path.write_bytes(text.encode() if isinstance(text, str) else text)
    return read_table(path, COLUMNS, optional, **options)


def read(tmp_path, text, optional=()):
    rows = table(tmp_path, text, optional)
    return rows.times(), rows.quaternions()


def test_a_table_is_read_whatever_its_order_and_line_ends(tmp_path):
    t, q = read(tmp_path, "﻿qw, qx,qy,qz,t\r\n1,0,0,0,0.5\r\n 0.6 ,0,0,-.8,1e0\r\n\r\n")
    assert t.tolist() == [0.5, 1.0]
    np.testing.assert_allclose(q, [[1, 0, 0, 0], [0.6, 0, 0, -0.8]], atol=1e-15)


def test_optional_columns_come_all_or_not_at_all(tmp_path):
    head = "t,qw,qx,qy,qz"
    assert "fx" in table(tmp_path, f"{head},fx,fy\n0,1,0,0,0,1,2\n", ("fx", "fy")).cells
    assert "fx" not in table(tmp_path, f"{head}\n0,1,0,0,0\n", ("fx", "fy")).cells
    with pytest.raises(InputError, match=r"row 1: got t,qw,qx,qy,qz,fx; allowed: columns .* if measured, fx,fy"):
        table(tmp_path, f"{head},fx\n0,1,0,0,0,1\n", ("fx", "fy"))


@pytest.mark.parametrize(
    ("text", "row", "parts"),
    [
        ("", 1, ["got ''", "columns t,qw,qx,qy,qz"]),
        ("t,qw,qx,qy\n0,1,0,0\n", 1, ["got t,qw,qx,qy;"]),
        ("t,qw,qx,qy,qz,extra\n0,1,0,0,0,1\n", 1, ["extra"]),
        ("t,t,qw,qx,qy,qz\n0,0,1,0,0,0\n", 1, ["t,t,"]),
        ("t,qw,qx,qy,qz\n", None, ["no row"]),
        ("t,qw,qx,qy,qz\n0,1,0,0\n", 2, ["4 cells", "5, as in the header"]),
        ("t,qw,qx,qy,qz\n0,1,0,0,0\n\n1,1,0,0,0\n", 3, ["0 cells"]),
        ("t,qw,qx,qy,qz\n0,1,0,0,0\nnan,1,0,0,0\n", 3, ["t = nan", "finite number"]),
        ("t,qw,qx,qy,qz\n0,1,0,0,0\n1_0,1,0,0,0\n", 3, ["t = 1_0"]),
        ("t,qw,qx,qy,qz\n0,1,0,inf,0\n", 2, ["qy = inf"]),
        ("t,qw,qx,qy,qz\n0,1,0,,0\n", 2, ["qy = ''"]),
        ("t,qw,qx,qy,qz\n0,1,0,1e999,0\n", 2, ["qy = 1e999"]),
        ("t,qw,qx,qy,qz\n0,1,0,0,0\n1,1,0,0,0\n1.0,1,0,0,0\n", 4, ["t = 1.0", "after 1 s", "again"]),
        ("t,qw,qx,qy,qz\n0,1,0,0,0\n1,1,0,0,0\n0.5,1,0,0,0\n", 4, ["t = 0.5", "after 1 s", "earlier"]),
        ("t,qw,qx,qy,qz\n0,1,0,0,0\n1,1,0.1,0,0\n", 3, ["(1, 0.1, 0, 0)", "norm 1.00499"]),
        ("t,qw,qx,qy,qz\n0,0,0,0,0\n", 2, ["norm 0"]),
        ('t,qw,qx,qy,qz\n0,"1,0,0,0\n', 2, ["unexpected end of data"]),
        (b"t,qw\xff", None, ["UTF-8"]),
        ("t,qw,qx,qy,qz\n0,\0,0,0,0\n", 2, ["qw = '\\x00'"]),
        ("t,qw,qx,qy,qz\n0," + "x" * 200_000 + ",0,0,0\n", 2, ["field larger than field limit"]),
    ],
)
def test_wrong_tables_are_refused_with_their_line(tmp_path, text, row, parts):
    with pytest.raises(InputError) as caught:
        read(tmp_path, text)
    for part in parts:
        assert part in str(caught.value)
    assert caught.value.row == row
    assert caught.value.path == str(tmp_path / "table.csv")
    assert len(str(caught.value)) < 400


def test_all_problems_are_handed_on_where_they_are_not_raised(tmp_path):
    problems = []
    text = "t,qw,qx,qy,qz\n0,1,0,0,0\n0,a,0,b,0\n1\n2,2,0,0,0\n"
    rows = table(tmp_path, text, refuse=problems.append)
    t, q = rows.times(), rows.quaternions()
    assert [(problem.row, problem.value) for problem in problems] == [
        (4, "1 cells"),
        (3, "t = 0"),
        (3, "qw = a"),
        (3, "qy = b"),
        (5, "qw, qx, qy, qz = (2, 0, 0, 0), of norm 2"),
    ]
    assert len(t) == len(q) == 3
