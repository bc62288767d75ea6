# SPDX-License-Identifier: MIT
"""The example of docs/how-to/calibrate-a-station.md, on a station that is written here; and its lab.yaml."""

import re
from pathlib import Path

import numpy as np
import yaml
from PIL import Image

from pinwm_drake.station.document import write_station
from pinwm_drake.station.lab import LabDocument
from tests.station.stations import station_document

PAGE = Path(__file__).resolve().parents[2] / "docs/how-to/calibrate-a-station.md"


def test_a_photo_becomes_the_view_of_a_policy(tmp_path, monkeypatch):
    code = re.search(r"```python\n(.*?)```", PAGE.read_text(encoding="utf-8"), re.DOTALL)[1]
    monkeypatch.chdir(tmp_path)
    write_station(tmp_path / "mylab/station/station.yaml", station_document())
    names = {"photo": np.full((720, 1280, 3), 40, np.uint8)}
    exec(compile(code, PAGE.name, "exec"), names)
    assert names["image"].shape == (64, 64, 3)
    assert np.array(Image.open("view.png"))[32, 32].tolist() == [40, 40, 40]


def test_the_lab_yaml_of_the_page_is_read():
    text = re.search(r"```yaml\n(.*?)```", PAGE.read_text(encoding="utf-8"), re.DOTALL)[1]
    LabDocument.model_validate(yaml.safe_load(text))
