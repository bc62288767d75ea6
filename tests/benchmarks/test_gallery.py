# SPDX-License-Identifier: MIT
import json
import re
import shutil
from pathlib import Path

import numpy as np
import pytest
from PIL import Image

from benchmarks.gallery.captures import EXHIBITS
from benchmarks.gallery.page import write_pages
from benchmarks.gallery.record import write_gif

RESULTS = Path(__file__).resolve().parents[2] / "docs/results/gallery"
# An object is on the page once its run is stored.
NAMES = [exhibit.name for exhibit in EXHIBITS if (RESULTS / f"{exhibit.name}.json").is_file()]


def test_three_objects_or_more_are_stored():
    assert {path.stem for path in RESULTS.glob("*.json")} == set(NAMES)
    assert len(NAMES) >= 3


def test_the_pages_are_those_of_the_stored_results(tmp_path):
    folder = tmp_path / "gallery"
    shutil.copytree(RESULTS, folder, ignore=shutil.ignore_patterns("*.md"))
    write_pages(folder)
    assert folder.with_suffix(".md").read_text() == RESULTS.with_suffix(".md").read_text()
    for path in folder.glob("*.md"):
        assert path.read_text() == (RESULTS / path.name).read_text()


@pytest.mark.parametrize("name", NAMES)
def test_every_object_has_figures_a_page_and_a_small_film(name):
    stored = json.loads((RESULTS / f"{name}.json").read_text())
    assert stored["name"] == name
    assert re.fullmatch(r"[0-9a-f]{7,}\+?", stored["machine"]["commit"])
    assert len(stored["commands"]) == 4
    assert stored["theta"]["friction_floor"]["truth"] > 0
    text = (RESULTS / f"{name}.md").read_text()
    assert f"({name}.gif)" in text
    film = RESULTS / f"{name}.gif"
    assert film.stat().st_size <= 400_000
    with Image.open(film) as image:
        assert image.n_frames == stored["capture"]["frames"][1]
        picture = np.asarray(image.convert("RGB")).astype(int)
    # On white, an object in colours on both halves.
    assert (picture[-1, -1] == 255).all()
    for half in np.array_split(picture, 2, axis=1):
        assert (np.ptp(half, axis=2) > 60).mean() > 0.03


def test_a_film_keeps_its_pictures_times_and_white(tmp_path):
    frames = []
    for k in range(5):
        frame = np.full((40, 60, 3), 255, np.uint8)
        frame[10:20, 5 * k : 5 * k + 10] = (200, 30, 40)
        frame[20:30, 5 * k : 5 * k + 10] = np.linspace((10, 30, 90), (200, 210, 250), 10)[None]
        frames.append(frame)
    write_gif(tmp_path / "a.gif", frames, 10.0)
    with Image.open(tmp_path / "a.gif") as film:
        assert film.n_frames == 5
        assert film.info["loop"] == 0
        for k, frame in enumerate(frames):
            film.seek(k)
            assert film.info["duration"] == (1500 if k == 4 else 100)
            shown = np.asarray(film.convert("RGB")).astype(int)
            assert np.abs(shown - frame).max() < 12
            assert (shown[frame.min(axis=2) == 255] == 255).all()
