# SPDX-License-Identifier: MIT
"""A push that is added again leaves the earlier episode until the new one is whole, and what a person made stays."""

import hashlib
import json

import cv2
import numpy as np
import pytest
import trimesh

from pinwm_drake.errors import InputError
from pinwm_drake.experiments.masking import Masked, hand_made_masks
from pinwm_drake.experiments.meshing import Meshed
from pinwm_drake.guide import runs
from pinwm_drake.guide.keep import put_in_place
from pinwm_drake.guide.lab import LabFolder
from pinwm_drake.guide.runs import REPLACED, run_mesh, run_push
from pinwm_drake.station import episode
from pinwm_drake.station.episode import Sources, add_episode
from tests.station.drawn_push import draw_push, write_csv_log, write_drawn_capture, write_mp4


@pytest.fixture(scope="module")
def push():
    return draw_push()


@pytest.fixture(scope="module", autouse=True)
def clocks():
    """The clock of a film is found once; how it is found is not looked at here."""
    known, find = {}, episode.find_clock

    def find_once(film, path, **options):
        key = film.t.tobytes(), *(frame.tobytes() for frame in film.frames)
        if key not in known:
            known[key] = find(film, path, **options)
        return known[key]

    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(episode, "find_clock", find_once)
        yield


@pytest.fixture
def lab(push, tmp_path, monkeypatch):
    """A lab with a push that the guide has added, whose masks of two images a person and a program made."""
    monkeypatch.setattr(runs, "mask_push", lambda *_: Masked(0, 0, []))
    lab = LabFolder(tmp_path / "mylab")
    capture, folder = write_drawn_capture(lab.capture, push), lab.path / "pushes/0000"
    (lab.path / "object.yaml").write_text("schema_version: 1\nname: block\n")
    folder.mkdir(parents=True)
    film, log = write_mp4(folder / "film.mp4", push.frames), write_csv_log(folder / "log.csv", push)
    add_episode(capture, Sources(film, log, camera=capture / "camera.json"), name="first")
    run_push(folder, lab, lambda *_: None)
    return lab


def paint(lab) -> bytes:
    """Masks of two images, one of them the program's own; returns the contents of the other."""
    masks = lab.capture / "episodes/0000/masks"
    masks.mkdir()
    for k, value in ((3, 255), (4, 200)):
        cv2.imwrite(str(masks / f"{k:05}.png"), np.full((240, 320), value, np.uint8))
    sha = hashlib.sha256((masks / "00004.png").read_bytes()).hexdigest()
    (masks / "made.json").write_text(json.dumps({"00004.png": sha}))
    return (masks / "00003.png").read_bytes()


def again(lab) -> list[str]:
    return run_push(lab.path / "pushes/0000", lab, lambda *_: None)


def test_an_episode_stays_where_the_push_is_refused(lab):
    episode = lab.capture / "episodes/0000"
    painted, before = paint(lab), (episode / "frames.csv").read_bytes()
    (lab.path / "pushes/0000/film.mp4").write_bytes(b"half a film")
    with pytest.raises(InputError, match=r"film\.mp4"):
        again(lab)
    assert (episode / "frames.csv").read_bytes() == before
    assert (episode / "masks/00003.png").read_bytes() == painted
    assert sorted(path.name for path in episode.parent.iterdir()) == ["0000", "first"]


def test_what_a_person_made_is_taken_over(lab):
    episode = lab.capture / "episodes/0000"
    painted = paint(lab)
    (episode / "start.yaml").write_text("X_WO: {p: [0, 0, 0.025], q: [1, 0, 0, 0]}\n")
    cut_out = np.full((240, 320, 4), 200, np.uint8)
    cv2.imwrite(str(episode / "rgb/00005.png"), cut_out)
    notes = again(lab)
    assert (episode / "masks/00003.png").read_bytes() == painted
    assert not (episode / "masks/00004.png").exists()  # the program's own is made anew
    assert (episode / "start.yaml").is_file()
    assert cv2.imread(str(episode / "rgb/00005.png"), cv2.IMREAD_UNCHANGED).shape == (240, 320, 4)
    assert not any("doubtful" in note for note in notes)
    assert not (lab.capture / REPLACED).exists()
    again(lab)  # and again
    assert (episode / "masks/00003.png").read_bytes() == painted


def test_what_belongs_to_other_images_stays_beside(lab, push):
    episode, painted = lab.capture / "episodes/0000", paint(lab)
    (episode / "notes.txt").write_text("mine")
    write_mp4(lab.path / "pushes/0000/film.mp4", push.frames[::-1][:40][::-1])  # begins later
    notes = again(lab)
    assert notes[-1].startswith("doubtful: masks/00003.png and 1 more files belonged to other images")
    kept = lab.capture / REPLACED / "0000-1"
    assert str(kept) in notes[-1]
    assert (kept / "masks/00003.png").read_bytes() == painted
    assert not (episode / "masks/00003.png").exists()
    assert (kept / "notes.txt").read_text() == "mine"


def test_an_earlier_episode_is_told_after_masks_that_were_refused(lab, push, monkeypatch):
    def refuse(*_) -> Masked:
        raise InputError("mesh", value="none", allowed="one")

    painted, kept = paint(lab), lab.capture / REPLACED / "0000-1"
    monkeypatch.setattr(runs, "mask_push", refuse)
    with pytest.raises(InputError, match="mesh: got none"):
        again(lab)
    assert not kept.exists()  # all of it was taken over
    write_mp4(lab.path / "pushes/0000/film.mp4", push.frames[::-1][:40][::-1])
    with pytest.raises(InputError, match="mesh: got none"):
        again(lab)
    monkeypatch.setattr(runs, "mask_push", lambda *_: Masked(0, 0, []))
    for _ in range(2):
        assert again(lab)[-1] == f"doubtful: an earlier episode of the push is still in {kept}"
        assert [path.name for path in kept.parent.iterdir()] == ["0000-1"]
    assert (kept / "masks/00003.png").read_bytes() == painted


@pytest.mark.parametrize("content", ["[]", "null", '{"object.obj": 1}'])
def test_a_damaged_record_is_refused_by_its_name(tmp_path, content):
    (tmp_path / "masks").mkdir()
    for name in ("masks/made.json", ".made.json"):
        (tmp_path / name).write_text(content)
    with pytest.raises(InputError, match=r"masks/made\.json"):
        hand_made_masks(tmp_path)
    with pytest.raises(InputError, match=r"\.made\.json"):
        put_in_place(tmp_path / "new.obj", tmp_path / "object.obj", tmp_path / "aside.obj")


def test_few_of_the_doubts_of_a_mesh_are_told(tmp_path, monkeypatch):
    lab, doubts = LabFolder(tmp_path), [f"a piece {k}" for k in range(9)]

    def make(folder, *, source, out, replace) -> Meshed:
        out.parent.mkdir(parents=True)
        out.write_text("made")
        return Meshed(out, trimesh.creation.box(), "hull", [], None, doubts)

    monkeypatch.setattr(runs, "make_mesh", make)
    notes = run_mesh(lab, lambda *_: None)
    assert len(notes) == 7
    assert notes[-1] == "doubtful: 4 more lines"


def test_a_mesh_that_a_person_edited_goes_aside(tmp_path):
    new, path, aside = tmp_path / "meshes/.object.obj", tmp_path / "meshes/object.obj", tmp_path / "replaced/object.obj"
    new.parent.mkdir()

    def made(text) -> bool:
        new.write_text(text)
        return put_in_place(new, path, aside)

    assert not made("first")
    assert not made("second")  # the program's own is replaced
    path.write_text("edited")
    assert made("third")
    assert (path.read_text(), aside.read_text()) == ("third", "edited")
    assert not made("fourth")
    path.write_text("fifth")
    assert not made("fifth")  # the same
    assert aside.read_text() == "edited"
    assert not new.exists()
