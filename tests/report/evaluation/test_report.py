# SPDX-License-Identifier: MIT
import dataclasses

import cv2
import numpy as np
import pytest
import trimesh
from scipy.stats import binomtest

from pinwm_drake.learning.evaluation import EpisodeResult, Evaluation
from pinwm_drake.report.camera import ViewCamera
from pinwm_drake.report.evaluation.episode import EpisodeRecord
from pinwm_drake.report.evaluation.figures import OUTCOMES, start_figure, steps_figure, success_figure
from pinwm_drake.report.evaluation.film import EpisodeFilm, FilmGrid
from pinwm_drake.report.evaluation.report import EvaluationStory, strip_steps, write_evaluation_report
from pinwm_drake.report.scene import Actor
from pinwm_drake.report.video import write_video
from pinwm_drake.spatial.poses import identity
from tests.report.twin.test_report import Page

LYING = (np.sqrt(0.5), np.sqrt(0.5), 0.0, 0.0)  # a quarter turn about x
BOX = trimesh.creation.box((0.1, 0.05, 0.05))


def record(seed, outcome="success", steps=5, yaw=0.0, views=True):
    """A box that slides to the goal, or beside it, turned by yaw all the way."""
    n = steps + 1
    c, s = np.cos(yaw / 2), np.sin(yaw / 2)
    a, b = LYING[:2]
    q_WO = np.tile([c * a, c * b, s * b, s * a], (n, 1))  # the turn about z after LYING
    p_WO = np.column_stack([np.linspace(0.1, 0.0, n), np.full(n, 0.02 * seed), np.full(n, 0.025)])
    at = np.array(strip_steps(steps) if views else [], int)
    shown = np.full((len(at), 8, 8, 3), 200, np.uint8)
    failure = "no <solution>" if outcome == "failure" else ""
    result = EpisodeResult(seed, outcome == "success", steps, 0.0123, 0.3, failure, 0.1, yaw)
    return EpisodeRecord(result, q_WO, p_WO, p_WO - np.array([0.07, 0.0, 0.0]), shown, at, np.zeros(0), 0.5)


@pytest.fixture(scope="module")
def film():
    camera = ViewCamera.look_at(np.array([0.0, -0.45, 0.55]), np.zeros(3), width=64, height=48, field_of_view=0.7)
    actor = Actor.from_mesh(BOX, (0.7, 0.1, 0.1), smooth=False)
    return EpisodeFilm(camera, 0.0, [actor], BOX, trimesh.creation.icosphere(1, 0.01), lambda _: identity())


def story(film, records):
    settings, provenance = {"engine": "point"}, {"policy": "a <policy>"}
    return EvaluationStory("Evaluation", "of a & b", records, 20, 0.1, LYING, settings, provenance, film)


def page(film, records, tmp_path):
    shares = []
    write_evaluation_report(tmp_path / "report.html", story(film, records), shares.append)
    assert shares[-1] == 1.0
    return Page((tmp_path / "report.html").read_text())


def test_where_an_episode_began_is_told_from_how_it_lies():
    assert record(3, yaw=0.7).start(LYING) == pytest.approx((0.1, 0.06, 0.7))
    assert record(0, yaw=-3.0).start(LYING) == pytest.approx((0.1, 0.0, -3.0))


def test_the_page_tells_what_failed(film, tmp_path):
    records = [record(0), record(1, "time limit", 20), record(2, "failure", 7), record(3, steps=9, yaw=0.5)]
    read = page(film, records, tmp_path)
    assert "2 of 4 episodes succeeded: 50.0 % (95 % interval 15.0 to 85.0 %, Wilson)" in read.text
    assert "successes took 7.0 actions on average, 7 in the median" in read.text
    assert "all episodes took 10.2 actions on average, 8 in the median" in read.text
    assert "1 ran into the time limit" in read.text
    assert "in 1 the physics failed" in read.text
    assert "Episodes that failed" in read.text
    assert "seed 1: time limit after 20 actions, 12.3 mm and 17.2° from the goal" in read.text
    assert "seed 2: failure after 7 actions, 12.3 mm and 17.2° from the goal (no <solution>)" in read.text
    assert "seed 0: success" not in read.text
    assert "3 success 9 12.3 17.2 100.0 60.0 28.6" in read.text
    assert "policy's image" in read.text
    assert "a <policy>" in read.text
    assert all(url.startswith("data:") for url in read.urls)


def test_names_are_text_and_not_html(film, tmp_path):
    nasty = '</h1><script>alert("1")</script>{{ title }}'
    told = dataclasses.replace(story(film, [record(0)]), title=nasty, about=nasty, settings={nasty: nasty})
    write_evaluation_report(tmp_path / "report.html", told)
    read = Page((tmp_path / "report.html").read_text())
    assert read.text.count(nasty) == 5  # the title twice
    assert [script for script in read.scripts if "alert" in script] == []


def test_without_failures_it_shows_the_slowest(film, tmp_path):
    records = [record(k, steps=3 + k, views=False) for k in range(6)]
    read = page(film, records, tmp_path)
    assert "The slowest episodes None failed." in read.text
    shown = [k for k in range(6) if f"seed {k}: success after {3 + k} actions" in read.text]
    assert shown == [2, 3, 4, 5]
    assert "policy's image" not in read.text


def test_of_many_failures_the_first_are_shown(film, tmp_path):
    read = page(film, [record(k, "time limit", 2, views=False) for k in range(14)], tmp_path)
    assert "The first 12 of 14; the table has the others." in read.text


def test_the_curve_is_the_share_so_far():
    results = tuple(
        record(k, outcome, steps).result
        for k, (outcome, steps) in enumerate([("success", 3), ("success", 3), ("success", 8), ("time limit", 10)])
    )
    (axes,) = success_figure(Evaluation(results), 10).axes
    x, y = axes.lines[0].get_data()
    assert y[np.asarray(x) == 2] == 0.0
    assert y[np.asarray(x) == 3] == 0.5
    assert y[np.asarray(x) == 10] == 0.75
    band = axes.collections[0].get_paths()[0].vertices
    low, high = binomtest(3, 4).proportion_ci(method="wilson")
    at_end = band[np.isclose(band[:, 0], 10)][:, 1]
    assert (at_end.min(), at_end.max()) == pytest.approx((low, high))
    (bars,) = steps_figure(Evaluation(results), 10).axes
    heights = sum(patch.get_height() for patch in bars.patches)
    assert heights == 4


def test_starts_have_the_colours_of_their_outcomes():
    records = [record(0), record(1, "time limit", 20, yaw=1.0)]
    place, turn = start_figure(records, LYING).axes
    points = {line.get_color(): line.get_data() for line in turn.lines}
    assert points[OUTCOMES["time limit"]][0] == pytest.approx([np.degrees(1.0)])
    assert points[OUTCOMES["time limit"]][1] == [20]
    x, y = place.lines[0].get_data()
    assert (x[0], y[0]) == pytest.approx((100.0, 0.0))


def test_an_episode_that_ended_stays(film):
    short, long = record(0, steps=2), record(1, "time limit", 6)
    grid = FilmGrid(film, [short, long], columns=2)
    assert (grid.size, grid.steps) == ((128, 48), 6)
    pictures = [grid.picture(step) for step in range(7)]
    left, right = ([picture[:, part] for picture in pictures] for part in (np.s_[:64], np.s_[64:]))
    assert (left[0] != left[1]).any()
    assert (left[1] != left[2]).any()
    for picture in left[3:]:
        np.testing.assert_array_equal(picture, left[2])
    assert (right[5] != right[6]).any()
    assert left[2][0, 0].tolist() == [59, 143, 90]
    assert right[6][0, 0].tolist() == [200, 67, 47]


def test_pictures_that_are_kept_are_those_that_would_be_drawn(film):
    records = [record(0, steps=2), record(1, steps=9)]
    grid = FilmGrid(film, records, keep=4)
    assert grid.kept == [0, 3, 6, 9]
    for step in (3, 4):
        once, again = grid.picture(step), grid.picture(step)
        assert (once is again) == (step == 3)
        np.testing.assert_array_equal(again, FilmGrid(film, records).picture(step))


def test_the_film_is_a_video(film, tmp_path):
    grid = FilmGrid(film, [record(k, steps=2 + k) for k in range(5)])
    assert grid.size == (256, 96)
    write_video(tmp_path / "film.mp4", grid.pictures(), rate=10.0, size=grid.size)
    reader = cv2.VideoCapture(str(tmp_path / "film.mp4"))
    assert reader.get(cv2.CAP_PROP_FRAME_COUNT) == 7 + 8
