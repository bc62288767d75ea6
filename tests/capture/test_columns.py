# SPDX-License-Identifier: MIT
import math
import re
from pathlib import Path

import numpy as np
import pytest

from pinwm_drake.capture.importers.columns import make_trajectory, parse_columns
from pinwm_drake.capture.importers.csv_log import read_csv
from pinwm_drake.errors import InputError, ParameterError


def log(tmp_path: Path, text: str):
    (tmp_path / "robot.csv").write_text(text)
    return read_csv(tmp_path / "robot.csv")


def test_units_that_are_stated_are_obeyed(tmp_path):
    table = log(tmp_path, "stamp;x;y;a;f\n1000;10;5;90;1000\n1020;12;5;90;2000\n")
    text = "t=stamp[ms],px=x[mm],py=-y[cm],pz=0.03[m],yaw=a[deg],fx=f[mN],fy=0,fz=0"
    motion, notes = make_trajectory(table, parse_columns(text))
    assert notes == []
    np.testing.assert_allclose(motion.t, [1.0, 1.02])
    np.testing.assert_allclose(motion.p_WP, [[0.01, -0.05, 0.03], [0.012, -0.05, 0.03]])
    np.testing.assert_allclose(motion.q_WP, [[math.sqrt(0.5), 0, 0, math.sqrt(0.5)]] * 2)
    np.testing.assert_allclose(motion.v_WP, [[0.1, 0, 0], [0, 0, 0]], atol=1e-12)
    np.testing.assert_allclose(motion.force_W, [[1, 0, 0], [2, 0, 0]])


def test_what_is_not_stated_is_guessed_aloud(tmp_path):
    rows = "".join(f"{1.7e12 + 20 * k:.0f},{100 + 2 * k},50,30,100\n" for k in range(60))
    motion, notes = make_trajectory(log(tmp_path, f"timestamp,x,y,z,vx\n{rows}"), {})
    assert motion.t[1] - motion.t[0] == pytest.approx(0.02, abs=1e-6)
    np.testing.assert_allclose(motion.p_WP[1], [0.102, 0.05, 0.03])
    assert notes == [
        "columns guessed: t=timestamp,px=x,py=y,pz=z",
        "t taken for ms: state it as t=timestamp[ms]",
        "px, py, pz taken for mm (a way of 118): state it as px=x[mm]",
    ]


def test_velocities_get_the_unit_that_suits_the_positions(tmp_path):
    rows = "".join(f"{0.02 * k},{0.002 * k},0,0,100,0\n" for k in range(60))
    given = parse_columns("t=t[s],px=x[m],py=y[m],pz=z[m],vx=vx,vy=vy")
    motion, notes = make_trajectory(log(tmp_path, f"t,x,y,z,vx,vy\n{rows}"), given)
    np.testing.assert_allclose(motion.v_WP, [[0.1, 0, 0]] * 60)
    assert notes == ["velocities taken for mm/s: state it as vx=vx[mm/s]"]


def test_velocities_that_do_not_suit_give_way_to_differences(tmp_path):
    rows = "".join(f"{0.02 * k},{0.002 * k},0,0,37,0\n" for k in range(60))
    given = parse_columns("t=t[s],px=x[m],py=y[m],pz=z[m],vx=vx,vy=vy")
    motion, notes = make_trajectory(log(tmp_path, f"t,x,y,z,vx,vy\n{rows}"), given)
    np.testing.assert_allclose(motion.v_WP[:-1], [[0.1, 0, 0]] * 59)
    assert notes == ["velocities of the log do not suit its positions; differences of positions are taken"]


def test_units_in_the_header_count(tmp_path):
    motion, _ = make_trajectory(log(tmp_path, "time [ms],x [mm],y [mm],z [mm]\n0,1,0,0\n20,2,0,0\n"), {})
    np.testing.assert_allclose(motion.t, [0, 0.02])
    np.testing.assert_allclose(motion.p_WP[:, 0], [0.001, 0.002])


def test_rows_without_numbers_duplicates_and_short_rows_are_dropped_and_counted(tmp_path):
    text = "# robot 3\nt,px,py,pz\n0,0,0,0\n0.01,nan,0,0\n0.02,0,0,0\n0.02,0,0,0\n0.03,0\n0.01,0,0,0\n0.04,0,0,0\n"
    motion, notes = make_trajectory(log(tmp_path, text), {})
    np.testing.assert_allclose(motion.t, [0, 0.02, 0.04])
    assert notes == [
        "1 row with another number of cells than the header dropped",
        "1 row without a time dropped",
        "1 row with the time of the one before dropped",
        "1 row with a time that goes backwards dropped",
    ]


def test_columns_without_a_header_have_numbers(tmp_path):
    given = parse_columns("t=1[s],px=2[m],py=3[m],pz=0.05[m]")
    motion, _ = make_trajectory(log(tmp_path, "0 0.1 0.2\n0.01 0.1 0.2\n"), given)
    np.testing.assert_allclose(motion.p_WP, [[0.1, 0.2, 0.05]] * 2)


@pytest.mark.parametrize(
    ("text", "words"),
    [
        ("px", "got px; allowed: NAME=COLUMN[UNIT]"),
        ("dx=x", "got dx; allowed: t, px"),
        ("px=x,px=y", "got px twice"),
        ("px=x[s]", "got px in [s]; allowed: m, cm, mm"),
    ],
)
def test_a_wrong_map_is_refused(text, words):
    with pytest.raises(ParameterError, match=re.escape(words)):
        parse_columns(text)


@pytest.mark.parametrize(
    ("text", "columns", "words"),
    [
        ("t,px,py\n0,0,0\n1,0,0\n", "", "no column for pz"),
        ("t,a,b\n0,0,0\n1,0,0\n", "", "no column for px"),
        ("t,px,py,pz\n0,0,0,0\n1,0,0,0\n", "t=t,px=q,py=py,pz=pz", "no column q for px"),
        ("t,px,py,pz,fx\n0,0,0,0,0\n1,0,0,0,0\n", "", "got only fx"),
        ("t,px,py,pz,qw,qx,qy,qz\n0,0,0,0,2,0,0,0\n1,0,0,0,2,0,0,0\n", "", "of norm 2"),
        ("t,px,py,pz\n0,0,0,0\n", "", "times 0 apart"),
        ("t,t\n0,0\n", "", "t twice"),
        ("", "", "no row"),
    ],
)
def test_a_log_that_cannot_be_used_is_refused(tmp_path, text, columns, words):
    with pytest.raises(InputError, match=re.escape(words)):
        make_trajectory(log(tmp_path, text), parse_columns(columns))
