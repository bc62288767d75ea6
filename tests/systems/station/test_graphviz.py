# SPDX-License-Identifier: MIT
import re
import runpy
import shutil
import sys
from pathlib import Path

import pytest

from pinwm_drake.systems.scenario.schema import Scenario
from pinwm_drake.systems.scenario.setup import Setup, make_setup
from pinwm_drake.systems.station.graphviz import PICTURED, plain, station_dot, write_pictures
from pinwm_drake.systems.station.station import make_station

DOCS = Path(__file__).parents[3] / "docs"


@pytest.fixture(scope="module")
def setup() -> Setup:
    return make_setup(Scenario(object="t_block"))


@pytest.mark.parametrize("engine", PICTURED)
def test_the_pictures_in_the_docs_are_those_of_the_station(setup, engine):
    shown = (DOCS / f"station_{engine}.dot").read_text(encoding="utf-8")
    assert station_dot(make_station(setup, engine)) == shown, "run python -m pinwm_drake.systems.station.graphviz docs"
    picture = (DOCS / f"station_{engine}.svg").read_text(encoding="utf-8")
    for name in re.findall(r"<B>(\w+)</B>", shown):
        assert f">{name}<" in picture


def test_both_plants_look_alike(setup):
    texts = [station_dot(make_station(setup, engine)) for engine in ("hydroelastic", "point")]
    assert texts[0].replace("station_hydroelastic", "station_point") == texts[1]


def test_numbers_do_not_depend_on_the_process():
    lines = (
        "digraph _7 {{\nsubgraph cluster{a}diagram {{\nlabel=<<B>pinwm_drake.systems.station.station.SceneStation</B>",
        "subgraph clusters{a}in {{\ns{a}in [shape=none]\ns{b} [shape=none]\n<TD>Source_{c}_pose</TD>\n{edges}\n}}",
    )
    text = "\n".join(lines)
    first, second = "s12in:0:e -> s30:u0:w [color=blue];", "s30:y0:e -> s12out:0:w"
    other = [line.replace("s12", "s3").replace("s30", "s9") for line in (second, first)]
    one = plain(text.format(a=12, b=30, c=8, edges=f"{first}\n{second}"))
    assert one == plain(text.format(a=3, b=9, c=77, edges="\n".join(other)))
    assert "s2:y0:e -> s1out:0:w" in one
    assert "<B>SceneStation</B>" in one
    assert "Source_0_pose" in one


def test_without_graphviz_there_is_the_text(tmp_path, monkeypatch):
    monkeypatch.setattr(shutil, "which", lambda _: None)
    assert [path.name for path in write_pictures(tmp_path)] == [f"station_{engine}.dot" for engine in PICTURED]


@pytest.mark.filterwarnings("ignore:.*found in sys.modules")
def test_it_says_how_it_is_run(monkeypatch):
    monkeypatch.setattr(sys, "argv", ["graphviz"])
    with pytest.raises(SystemExit, match="usage"):
        runpy.run_module("pinwm_drake.systems.station.graphviz", run_name="__main__")
