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
    rows = "".join(f"{1.7e12 + 20 * k:.0f},{100 + 2 * k},50,30\n" for k in range(60))
    motion, notes = make_trajectory(log(tmp_path, f"timestamp,x,y,z\n{rows}"), {})
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
    assert notes == ["vx, vy taken for mm/s: state it as vx=vx[mm/s]"]


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
        "1 row without 4 cells dropped, the first row 7",
        "1 row without a number for px dropped, the first row 4: px = nan",
        "1 row with the time of the one before dropped",
        "1 row with a time that goes backwards dropped",
    ]


def test_cells_may_be_quoted_after_a_space(tmp_path):
    table = log(tmp_path, 't, "px", "py", "pz"\n0, "0.1", 0, 0\n1, "0.2", 0, 0\n')
    np.testing.assert_allclose(make_trajectory(table, {})[0].p_WP[:, 0], [0.1, 0.2])


def test_columns_without_a_header_have_numbers(tmp_path):
    given = parse_columns("t=1[s],px=2[m],py=3[m],pz=0.05[m]")
    motion, _ = make_trajectory(log(tmp_path, "0 0.1 0.2\n0.01 0.1 0.2\n"), given)
    np.testing.assert_allclose(motion.p_WP, [[0.1, 0.2, 0.05]] * 2)


@pytest.mark.parametrize("text", ["0,0,0.1,0\n1,0,,0\n2,0,0.1,0\n", ",,,\n0,nan,0.1,0\n1,0,0.1,0\n2,0,0.1,0\n"])
def test_the_first_row_without_a_header_counts(tmp_path, text):
    table = log(tmp_path, text)
    assert list(table.values) == ["1", "2", "3", "4"]
    assert table.values["1"].tolist() == [0, 1, 2]
    assert table.rows.tolist() == [k + text.startswith(",") for k in (1, 2, 3)]


def test_rows_without_a_velocity_are_told_by_their_cell(tmp_path):
    text = 't,px,py,pz,vx,vy\n# a comment with a " in it\n0,0,0,0,0,0\n\n1,0,0,0,stop,0\n2,0,0,0,0,0\n3,0,0,0,0,0\n'
    given = parse_columns("t=t[s],px=px,py=py,pz=pz,vx=vx[m/s],vy=vy[m/s]")
    motion, notes = make_trajectory(log(tmp_path, text), given)
    assert motion.t.tolist() == [0, 2, 3]
    assert notes == ["1 row without a number for vx dropped, the first row 5: vx = stop"]


def test_a_force_without_a_unit_is_told(tmp_path):
    table = log(tmp_path, "t,px,py,pz,fx,fy,fz [kN]\n0,0,0,0,1,2,3\n1,0,0,0,1,2,3\n")
    motion, notes = make_trajectory(table, {})
    assert motion.force_W.tolist() == [[1, 2, 3000]] * 2
    assert notes[1:] == ["fx, fy taken for N: state it as fx=fx[N]"]


def test_a_velocity_without_vz_has_that_of_the_positions(tmp_path):
    table = log(tmp_path, "t,px,py,pz,vx,vy\n0,0,0,0,1,2\n1,0,0,3,1,2\n2,0,0,6,1,2\n")
    motion, notes = make_trajectory(table, parse_columns("t=t[s],px=px,py=py,pz=pz[m],vx=vx[m/s],vy=vy[m/s]"))
    assert motion.v_WP.tolist() == [[1, 2, 3], [1, 2, 3], [1, 2, 0]]
    assert notes == ["no column for vz; differences of positions are taken"]


def test_a_yaw_has_its_unit_and_zero_needs_none(tmp_path):
    table = log(tmp_path, "t,px,py,pz,yaw [deg],a\n0,0,0,0,90,0\n1,0,0,0,90,0\n")
    motion, _ = make_trajectory(table, {})
    np.testing.assert_allclose(motion.q_WP, [[math.sqrt(0.5), 0, 0, math.sqrt(0.5)]] * 2)
    motion, _ = make_trajectory(table, parse_columns("t=t,px=px,py=py,pz=pz,yaw=a"))
    assert motion.q_WP.tolist() == [[1, 0, 0, 0]] * 2


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
        ("t,px,py,pz,fx\n0,0,0,0,0\n1,0,0,0,0\n", "", "got only fx=fx; allowed: fx, fy, fz; no force"),
        ("t,px,py,pz,vx\n0,0,0,0,0\n1,0,0,0,0\n", "", "got only vx=vx; allowed: vx, vy; no velocity"),
        ("t,px,py,pz,qw,qz\n0,0,0,0,1,0\n1,0,0,0,1,0\n", "", "got only qw=qw and qz=qz; allowed: qw, qx, qy, qz"),
        ("t,px,py,pz,theta\n0,0,0,0,0\n1,0,0,0,90\n", "", "row 3: got theta = 90 without one; allowed: a unit"),
        ("t,px,py,pz,yaw,qw,qx,qy,qz\n0,0,0,0,0,1,0,0,0\n1,0,0,0,0,1,0,0,0\n", "", "yaw and qw, qx, qy, qz"),
        ("t,px,py,pz,fx,fy,fz\n0,0,0,0,1,1,1\n1,0,0,0,1,,1\n", "", "row 3: got fy = ''; allowed: a finite number"),
        ("t,x (ft),py,pz\n0,0,0,0\n1,0,0,0\n", "", "got column x (ft) for px; allowed: m, cm, mm"),
        ("t,px,py,pz\n0,0,0,\n1,0,0,up\n", "", "0 rows of 2 with numbers; row 2: pz = ''; allowed: two or more"),
        ("t,px,py,pz,qw,qx,qy,qz\n0,0,0,0,2,0,0,0\n1,0,0,0,2,0,0,0\n", "", "row 2: got 2 quaternions of norm 2"),
        ("t,px,py,pz\n0,0,0,0\n1,1e308,0,0\n", "", "row 3: got px = 1e308; allowed: a place within 1000 m"),
        ("t,px,py\n0,0,0\n1,0,0\n", "t=t,px=px,py=py,pz=5000[m]", "got pz=5000; allowed: a place within 1000 m"),
        ("t,px,py,pz\n0,0,0,0\n", "", "times 0 apart"),
        ("\nt,t\n0,0\n", "", "row 2: got t twice"),
        ("", "", "no row"),
        (",,\n,\n", "", "no row"),
        ("0,0.1,0.o2\n1,0.1,0.2\n", "", "row 1: got 0.o2 beside 0; allowed: a header of names, or a row of numbers"),
    ],
)
def test_a_log_that_cannot_be_used_is_refused(tmp_path, text, columns, words):
    with pytest.raises(InputError, match=re.escape(words)):
        make_trajectory(log(tmp_path, text), parse_columns(columns))
