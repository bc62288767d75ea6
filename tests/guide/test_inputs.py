# SPDX-License-Identifier: MIT
"""Input of the stages, and what the record says of it."""

import json
import shutil
from dataclasses import replace
from itertools import islice
from pathlib import Path

import pytest
import yaml
from PIL import Image

from pinwm_drake.errors import InputError
from pinwm_drake.guide.guide import guide_lab
from pinwm_drake.guide.page import PAGE_FILE
from pinwm_drake.guide.record import Entry, Record
from pinwm_drake.guide.runs import is_good_enough
from pinwm_drake.guide.stages import stages
from tests.guide.test_guide import brought, states

__all__ = ["brought"]


def entry_of(lab, found, key):
    """Record of a stage with its input as it is now."""
    stage = next(status.stage for status in found.seen if status.stage.key == key)
    return Entry(Record.read(lab.path).fingerprint(key, stage.inputs))


def test_images_elsewhere_and_masks_that_frames_name_are_input(brought, tmp_path):
    elsewhere = tmp_path / "elsewhere"
    elsewhere.mkdir()
    document = json.loads(brought.transforms.read_text())
    for k, frame in enumerate(document["frames"]):
        with Image.open(brought.static / frame["file_path"]) as image:
            image.convert("RGB").save(elsewhere / f"{k}.png")
            image.getchannel("A").save(elsewhere / f"mask{k}.png")
        frame |= {"file_path": str(elsewhere / f"{k}.png"), "mask_path": str(elsewhere / f"mask{k}.png")}
    brought.transforms.write_text(json.dumps(document))
    found = guide_lab(brought.path, run=False)
    assert states(found)["masks"] == states(found)["pose"] == "done"
    inputs = entry_of(brought, found, "appearance").inputs
    assert {str(elsewhere / "3.png"), str(elsewhere / "mask3.png")} <= inputs.keys()


def test_the_mesh_of_the_pusher_is_input(brought):
    shutil.copy(brought.mesh, brought.capture / "meshes/tip.obj")
    scene = yaml.safe_load(brought.scene.read_text())
    scene["pusher"] = {"mesh": "meshes/tip.obj", "shape": None}
    brought.scene.write_text(yaml.safe_dump(scene))
    (brought.path / "pushes/0000").mkdir(parents=True)
    (brought.path / "pushes/0000/film.mp4").write_bytes(b"")
    for name in ("surfels.ply", "twin.yaml"):
        brought.twin.mkdir(exist_ok=True)
        (brought.twin / name).write_bytes(b"")
    given = {stage.key: stage.inputs for stage in islice(stages(brought), 11)}
    tip = brought.capture / "meshes/tip.obj"
    assert [key for key, inputs in given.items() if tip in inputs] == ["push 0000", "check", "twin"]


def test_an_interrupted_stage_is_called_so_and_goes_on(brought):
    found = guide_lab(brought.path, run=False)
    record = Record.read(brought.path)
    record.put("appearance", replace(entry_of(brought, found, "appearance"), error="interrupted"))
    found = guide_lab(brought.path, run=False)
    assert states(found)["appearance"] == "interrupted"
    assert found.error == ""
    assert "interrupted" in (brought.path / PAGE_FILE).read_text()


def test_a_painted_mask_is_input_of_the_masks(brought):
    found = guide_lab(brought.path, run=False)
    Record.read(brought.path).put("masks", entry_of(brought, found, "masks"))
    assert states(guide_lab(brought.path, run=False))["masks"] == "done"
    (brought.static / "masks").mkdir()
    image = json.loads(brought.transforms.read_text())["frames"][0]["file_path"]
    with Image.open(brought.static / image) as picture:
        picture.getchannel("A").save(brought.static / "masks" / f"{Path(image).stem}.png")
    assert states(guide_lab(brought.path, run=False))["masks"] == "out of date"


def test_a_proposal_that_is_no_mapping_is_refused(brought):
    brought.next.mkdir()
    assert not is_good_enough(brought)
    for text, good in (("good_enough: true", True), ("good_enough: false", False), ("a: 1", False)):
        (brought.next / "push.yaml").write_text(text)
        assert is_good_enough(brought) is good
    (brought.next / "push.yaml").write_text("- 1")
    with pytest.raises(InputError, match=r"push\.yaml"):
        is_good_enough(brought)
