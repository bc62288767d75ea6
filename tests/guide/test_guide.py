# SPDX-License-Identifier: MIT
import json
import os
import shutil
from functools import partial

import pytest
import yaml
from PIL import Image

from pinwm_drake.errors import InputError
from pinwm_drake.guide import runs
from pinwm_drake.guide.guide import guide_lab
from pinwm_drake.guide.lab import LabFolder, write_scene
from pinwm_drake.guide.new import new_lab
from pinwm_drake.guide.page import PAGE_FILE, act_states
from pinwm_drake.guide.record import RECORD_FILE, Entry, Record
from pinwm_drake.guide.runs import push_files
from pinwm_drake.guide.stages import ACTS, FILL_IN, LENS, PHOTOS, PRINT, PUSH, ROBOT, TABLE
from pinwm_drake.station.document import write_station
from pinwm_drake.station.lab import ToolDocument
from tests.capture.pushed_cube import write_pushed_cube
from tests.station.stations import station_document

TOOL = {"shape": {"kind": "sphere", "radius": 0.012}}
BOX = {"low": [0.4, -0.2, 0.0], "high": [0.7, 0.2, 0.12]}


def fill_in(lab: LabFolder, **values) -> None:
    """Write values into `lab.yaml`."""
    path = lab.path / "lab.yaml"
    path.write_text(yaml.safe_dump({**yaml.safe_load(path.read_text()), **values}, sort_keys=False))


def put_pictures(folder, number: int) -> None:
    folder.mkdir(parents=True, exist_ok=True)
    for k in range(number):
        Image.new("RGB", (64, 48), (120, 130, 140)).save(folder / f"{k}.png")


def states(found) -> dict[str, str]:
    return {status.stage.key: status.state for status in found.seen}


@pytest.fixture
def lab(tmp_path):
    return new_lab(tmp_path / "mylab")


@pytest.fixture
def brought(tmp_path):
    """A lab whose capture was made elsewhere: the pushed cube, whose images have alpha."""
    lab = LabFolder(tmp_path / "mylab")
    write_pushed_cube(lab.capture)
    return lab


def test_a_new_lab_has_folders_a_board_and_a_page_of_what_to_film(lab):
    names = {path.relative_to(lab.path).as_posix() for path in lab.path.rglob("*")}
    assert {"lens", "robot", "table", "photos/fixed", "mesh", "pushes/0000", "board.pdf", "lab.yaml"} <= names
    page = (lab.path / "what-to-film.md").read_text()
    assert all(act in page for act in ACTS)
    with pytest.raises(InputError, match="something there already"):
        new_lab(lab.path)


def test_a_person_has_twelve_acts_at_most():
    assert len(ACTS) <= 12


def test_the_act_that_comes_next_follows_from_the_files(lab):
    acts = []

    def look() -> None:
        acts.append(guide_lab(lab.path, run=False).act)

    look()
    fill_in(lab, ruler=0.0998)
    look()
    fill_in(lab, workspace=BOX, tool=TOOL)
    look()
    put_pictures(lab.path / "lens", 5)
    look()
    put_pictures(lab.path / "robot", 6)
    look()
    assert acts == [ACTS[k] for k in (PRINT, FILL_IN, LENS, ROBOT, TABLE)]
    put_pictures(lab.path / "table", 3)
    found = guide_lab(lab.path, run=False)
    assert states(found) == {"board": "done", "calibration": "ready"}
    write_station(lab.station, station_document())
    found = guide_lab(lab.path, run=False)
    assert found.act == ACTS[PHOTOS]
    assert act_states(found)[:6] == ["done"] * 5 + ["next"]
    assert set(act_states(found)[6:]) == {"later"}


def test_a_stage_that_is_refused_says_why_and_is_tried_again(lab):
    fill_in(lab, ruler=0.0998, workspace=BOX, tool=TOOL)
    for name, number in (("lens", 5), ("robot", 6), ("table", 3)):
        put_pictures(lab.path / name, number)
    found = guide_lab(lab.path)
    assert states(found)["calibration"] == "failed"
    assert "robot.csv" in found.error
    assert "no row below the header" in found.error
    page = (lab.path / PAGE_FILE).read_text()
    assert "no row below the header" in page
    assert states(guide_lab(lab.path, run=False))["calibration"] == "failed"
    rows = ["file,x,y,z,rx,ry,rz", *(f"robot/{k}.png,{400 + 50 * k},0,300,0,0,{30 * k}" for k in range(6))]
    (lab.path / "robot.csv").write_text("\n".join(rows) + "\n")
    assert states(guide_lab(lab.path, run=False))["calibration"] == "out of date"
    assert "the board in 0 of 14 photos" in guide_lab(lab.path).error


def test_a_file_that_is_refused_stops_the_guide_in_one_line(lab):
    fill_in(lab, ruler=0.2, workspace=BOX, tool=TOOL)
    found = guide_lab(lab.path)
    assert "ruler" in found.error
    assert "\n" not in found.error
    assert found.seen == []
    assert found.number is None
    assert (lab.path / PAGE_FILE).is_file()


def test_words_of_files_are_text_on_the_page(lab):
    fill_in(lab, ruler="<script>alert(1)</script>", workspace=BOX, tool=TOOL)
    found = guide_lab(lab.path)
    assert "<script>alert(1)" in found.error
    assert "<script>alert(1)" not in (lab.path / PAGE_FILE).read_text()


def test_what_was_made_elsewhere_stays(brought):
    before = {path: path.read_bytes() for path in brought.capture.rglob("*") if path.is_file()}
    found = guide_lab(brought.path, run=False)
    assert states(found) == {
        **dict.fromkeys(["board", "calibration", "photos", "scene", "masks", "mesh", "pose"], "done"),
        "appearance": "ready",
    }
    assert found.seen[-2].notes == ("made elsewhere",)
    assert {path: path.read_bytes() for path in before} == before
    page = (brought.path / PAGE_FILE).read_text()
    assert page.count("data:image/jpeg") >= 3 * 6  # photos; masks; the mesh over the photos


def test_without_a_push_the_guide_proposes_one_and_asks_for_it(brought, monkeypatch):
    shutil.rmtree(brought.capture / "episodes")
    brought.twin.mkdir()
    (brought.twin / "surfels.ply").write_bytes(b"")
    assert states(guide_lab(brought.path, run=False))["first"] == "ready"
    monkeypatch.setattr(runs, "next_push", partial(runs.next_push, number=2, draws=2))
    found = guide_lab(brought.path)
    assert (found.act, states(found)["first"], states(found)["push"]) == (ACTS[PUSH], "done", "missing")
    assert (brought.first / "trajectory.csv").is_file()
    assert "next_push.png" in (brought.path / PAGE_FILE).read_text()
    brought.scene.write_text(brought.scene.read_text().replace("mass: 0.2", "mass: 0.3"))
    assert states(guide_lab(brought.path, run=False))["first"] == "out of date"


def test_a_stage_is_out_of_date_when_an_input_has_another_hash(lab):
    path, key = lab.path / "object.yaml", "scene"
    write_station(lab.station, station_document())
    put_pictures(lab.photos, 8)
    record = Record.read(lab.path)
    record.put(key, Entry(record.fingerprint(key, [path, ("data", {"a": 1})]), ("a note",), seconds=1.5))
    again = Record.read(lab.path)
    assert again.entries[key].notes == ("a note",)
    os.utime(path, (1, 1))  # newer or older, but the same
    assert again.changed(key, again.fingerprint(key, [path, ("data", {"a": 1})])) == []
    assert again.changed(key, again.fingerprint(key, [path, ("data", {"a": 2})])) == ["data"]
    path.write_text(path.read_text() + "\n")
    assert again.changed(key, again.fingerprint(key, [path, ("data", {"a": 1})])) == ["object.yaml"]
    assert again.changed(key, again.fingerprint(key, [("data", {"a": 1})])) == ["object.yaml"]


def test_a_damaged_record_is_refused(lab):
    for text in ("[]", '{"schema_version": 9, "stages": {}}', '{"schema_version": 1, "stages": {"a": 1}}'):
        (lab.path / RECORD_FILE).write_text(text)
        with pytest.raises(InputError, match="a record of pinwm lab"):
            guide_lab(lab.path)


def test_a_folder_without_a_lab_is_refused(tmp_path):
    with pytest.raises(InputError, match="pinwm lab new"):
        guide_lab(tmp_path)


def test_the_scene_takes_pusher_and_table_of_the_station_and_keeps_the_pose(lab):
    document = station_document()
    write_station(lab.station, document)
    with pytest.raises(InputError, match="no pusher"):
        write_scene(lab)
    tool = document.tool.model_validate(TOOL)
    table = document.world.table.model_copy(update={"height": 0.018})
    world = document.world.model_copy(update={"table": table})
    station = write_station(lab.station, document.model_copy(update={"tool": tool, "world": world}))
    lab.capture.mkdir()
    lab.scene.write_text("object: {X_WO: {p: [0.5, 0, 0.02], q: [1, 0, 0, 0]}}\n")
    write_scene(lab)
    scene = lab.read_scene()
    assert scene["floor"] == {"height": 0.018}
    assert scene["pusher"]["shape"] == {"kind": "sphere", "radius": 0.012}
    assert scene["station"] == station.sha256
    assert scene["object"]["X_WO"]["p"] == [0.5, 0, 0.02]
    assert "X_WO" not in lab.read_scene(found=False)["object"]


def test_files_of_a_push(tmp_path):
    (tmp_path / "film.mp4").write_bytes(b"")
    with pytest.raises(InputError, match=r"film.mp4 alone; allowed: the pusher's log.csv"):
        push_files(tmp_path)
    (tmp_path / "log.csv").write_text("")
    (tmp_path / "masks").mkdir()
    assert [None if path is None else path.name for path in push_files(tmp_path)] == ["film.mp4", "log.csv", "masks"]
    (tmp_path / "second.mp4").write_bytes(b"")
    with pytest.raises(InputError, match="one film"):
        push_files(tmp_path)


def test_the_record_is_plain_json(lab):
    guide_lab(lab.path)
    fill_in(lab, ruler=0.0998, workspace=BOX, tool=TOOL)
    for name, number in (("lens", 5), ("robot", 6), ("table", 3)):
        put_pictures(lab.path / name, number)
    guide_lab(lab.path)
    stages = json.loads((lab.path / RECORD_FILE).read_text())["stages"]
    assert len(stages["calibration"]["inputs"]["lab.yaml"][2]) == 64


def test_the_scene_is_written_with_its_comments(lab):
    write_station(lab.station, station_document().model_copy(update={"tool": ToolDocument.model_validate(TOOL)}))
    lab.capture.mkdir()
    lab.scene.write_text("# mine\ngravity: 9.7 # measured\nobject: {X_WO: {p: [0.5, 0, 0.02], q: [1, 0, 0, 0]}}\n")
    write_scene(lab)
    write_scene(lab)
    text = lab.scene.read_text()
    assert text.startswith("# mine\n")
    assert "gravity: 9.7 # measured\n" in text
    assert lab.read_scene()["pusher"]["shape"] == {"kind": "sphere", "radius": 0.012}
