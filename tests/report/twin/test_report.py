# SPDX-License-Identifier: MIT
import base64
import html.parser
import io
import json
import re
from dataclasses import replace
from pathlib import Path
from xml.etree import ElementTree

import numpy as np
import pytest
import torch
from jinja2 import UndefinedError
from PIL import Image

from pinwm_drake.capture.episodes import ObjectPoses, read_episode
from pinwm_drake.capture.scene import load_capture
from pinwm_drake.errors import InputError
from pinwm_drake.identification.history import read_history
from pinwm_drake.report.figures.history import loss_figure, theta_figure
from pinwm_drake.report.outline import boundary
from pinwm_drake.report.page import data_uri, templates
from pinwm_drake.report.twin.comparison_frames import Cast, draw_frame, draw_shots, window_of
from pinwm_drake.report.twin.data import read_ground_truth, read_story
from pinwm_drake.report.twin.report import _starts_words, write_twin_report
from pinwm_drake.report.twin.score import pose_errors
from pinwm_drake.spatial.poses import inverse, transform
from pinwm_drake.spatial.rotations import quaternion_exp
from pinwm_drake.twin.twin import Estimate
from pinwm_drake.twin.write import write_twin
from tests.report.samples import move, moved, write_history, write_identified, write_push
from tests.twin.samples import estimates

MACROS = templates.get_template("report/macros.html").module
VOID = {"meta", "br", "img", "input", "link"}


class Page(html.parser.HTMLParser):
    """The page as a browser reads it: what is in it, and whether its tags are closed in order."""

    def __init__(self, text: str) -> None:
        super().__init__()
        self.open: list[str] = []
        self.words, self.urls, self.scripts = [], [], []
        self.feed(text)
        assert self.open == []

    def handle_starttag(self, tag, attrs):
        self.urls += [value for name, value in attrs if name in ("src", "href", "data", "action", "poster")]
        if tag not in VOID:
            self.open.append(tag)

    def handle_endtag(self, tag):
        assert self.open.pop() == tag

    def handle_data(self, data):
        (self.scripts if self.open[-1:] == ["script"] else self.words).append(data)

    @property
    def text(self) -> str:
        return " ".join(" ".join(self.words).split())


def report(twin: Path, capture: Path | None = None) -> tuple[Page, list[str]]:
    """The page of a twin, and its notices."""
    story = read_story(twin, capture)
    write_twin_report(twin / "report.html", story)
    text = (twin / "report.html").read_text(encoding="utf-8")
    # Nothing from anywhere: the only addresses are those of SVG's vocabulary.
    assert set(re.findall(r"https?://[^\"' )]*", text)) <= {"http://www.w3.org/2000/svg"}
    return Page(text), story.notices


@pytest.fixture(scope="module")
def folder(tmp_path_factory) -> Path:
    """A capture, and a twin of it that is 2 mm beside the truth."""
    path = tmp_path_factory.mktemp("push")
    write_push(path / "capture")
    (path / "capture/ground_truth.yaml").write_text("mass: 0.25\nfriction_floor: 0.25\nrestitution: 0.0\n")
    lift = {"lift": Estimate(1e-3, (5e-4, 1.5e-3), True, "m")}
    write_identified(path / "twin", path / "capture", by=2e-3, nuisance=lift)
    return path


@pytest.fixture(scope="module")
def page(folder) -> Page:
    """The report of that twin."""
    page, notices = report(folder / "twin")
    assert notices == []
    return page


def test_the_page_tells_everything(folder, page):
    for words in (
        "Twin of cube",
        "The twin follows the video roughly",
        "position 2.00 mm on average, 2.00 mm at most; rotation 0.00° on average",
        "which was never fitted",
        "All 2 random starts agree within 5 %; the loss at the end is 0.1067",
        "The data determine friction_floor; they do not determine mass,",
        "0.300 0.270 to 0.330 yes 0.25 +20.0 %",
        "camera twin difference",
        "Ground truth was scored, never fitted",
        "pinwm identify",
        "align 1.50 s identify 3.25 s",
        str(folder / "capture"),
    ):
        assert words in page.text, words
    # Nothing is loaded: every address is the picture itself.
    assert page.urls
    assert all(url.startswith("data:image/") for url in page.urls)


def test_its_pictures_can_be_shown(page):
    kinds = {"image/svg+xml": 0, "image/jpeg": 0}
    frames = json.loads(page.scripts[0])
    for url in [*page.urls, *(frame["src"] for frame in frames)]:
        kind, data = re.fullmatch(r"data:([^;]+);base64,(.*)", url).groups()
        kinds[kind] += 1
        contents = base64.b64decode(data)
        if kind == "image/jpeg":
            Image.open(io.BytesIO(contents)).load()
        else:
            assert ElementTree.fromstring(contents).tag.endswith("svg")
    # Loss, parameters, motion, from above, errors; the player's first picture, strips of 4 frames, 4 frames.
    assert kinds == {"image/svg+xml": 5, "image/jpeg": 1 + 3 * 4 + 4}
    assert [frame["t"] for frame in frames] == [0.0, 0.1, 0.2, 0.3]
    assert "2.0 mm and 0.0° from ground truth" in frames[0]["words"]


def test_the_same_twin_gives_the_same_page(folder, page):
    first = (folder / "twin/report.html").read_bytes()
    report(folder / "twin")
    assert (folder / "twin/report.html").read_bytes() == first


def test_names_are_text_and_not_html(tmp_path):
    nasty = '</script><script>alert("1")</script>&amp;{{body}}<img src=http://evil.example/x>'
    write_push(tmp_path / "capture")
    theta = write_identified(tmp_path / "twin", tmp_path / "capture").theta
    theta = theta | {"mass": Estimate(0.2, None, False, "kg", nasty)}
    write_identified(
        tmp_path / "twin",
        tmp_path / "capture",
        name="0000",
        theta=theta,
        nuisance={nasty: Estimate(1.0, None, True, nasty, nasty)},
        provenance={"capture": nasty, "capture_sha256": nasty, "episode": nasty, nasty: [nasty, {nasty: nasty}]},
    )
    write_history(tmp_path / "twin/history.npz", names=np.array([nasty, "$x_"]))
    story = read_story(tmp_path / "twin")
    write_twin_report(tmp_path / "report.html", story)
    page = Page((tmp_path / "report.html").read_text())
    assert page.text.count(nasty) >= 8
    assert all(url.startswith("data:image/") for url in page.urls)
    assert [script for script in page.scripts if "alert" in script] == []


def test_without_its_capture_there_is_a_notice_and_no_picture(tmp_path):
    write_push(tmp_path / "capture")
    write_identified(tmp_path / "twin", tmp_path / "capture")
    elsewhere = move(tmp_path / "capture", tmp_path / "elsewhere")
    page, notices = report(tmp_path / "twin")
    assert len(notices) == 1
    assert "capture.yaml" in notices[0]
    assert notices[0] in page.text
    assert "--capture names the place where it is now" in page.text
    assert len(page.scripts) == 1
    assert "No images at hand" in page.text
    assert page.text.count("loss") > 1
    page, notices = report(tmp_path / "twin", elsewhere)
    assert notices == []
    assert "The twin reproduces the video" in page.text
    with pytest.raises(InputError, match=r"capture\.yaml"):
        read_story(tmp_path / "twin", tmp_path / "nowhere")


def test_a_capture_that_was_changed_is_noted(tmp_path):
    write_push(tmp_path / "capture")
    write_identified(tmp_path / "twin", tmp_path / "capture")
    # Where it lies, and what the truth is, does not count.
    elsewhere = move(tmp_path / "capture", tmp_path / "elsewhere")
    (elsewhere / "episodes/0000/object_poses.csv").unlink()
    assert read_story(tmp_path / "twin", elsewhere).notices == []
    table = elsewhere / "episodes/0000/trajectory.csv"
    table.write_text(table.read_text().replace("0.1,", "0.10001,", 1))
    notices = read_story(tmp_path / "twin", elsewhere).notices
    assert len(notices) == 1
    assert "SHA-256 differs" in notices[0]


def test_what_is_missing_or_broken_beside_the_twin_is_noted(tmp_path):
    write_push(tmp_path / "capture", truth=False)
    write_identified(tmp_path / "twin", tmp_path / "capture")
    (tmp_path / "twin/history.npz").write_bytes(b"PK")
    (tmp_path / "twin/episodes/0000.csv").write_text("t,px\n")
    (tmp_path / "capture/ground_truth.yaml").write_text("mass: heavy\n")
    page, notices = report(tmp_path / "twin")
    assert len(notices) == 3
    for words in ("history.npz: got unreadable", "0000.csv, row 1", 'mass = "heavy"; allowed: a finite number'):
        assert words in page.text
    assert "which was never fitted" not in page.text
    (tmp_path / "capture/ground_truth.yaml").unlink()
    write_identified(tmp_path / "twin", tmp_path / "capture")
    (tmp_path / "capture/episodes/0000/rgb/00002.png").write_bytes(b"no image")
    page, notices = report(tmp_path / "twin")
    assert len(notices) == 2
    assert any("00002.png" in notice for notice in notices)
    assert "Motion" in page.text
    # No history, no poses, no provenance: the parameters are left.
    twin = write_identified(tmp_path / "bare", tmp_path / "capture", provenance={})
    (tmp_path / "bare/history.npz").unlink()
    (tmp_path / "bare/episodes/0000.csv").unlink()
    page, notices = report(tmp_path / "bare")
    assert len(notices) == 3
    assert "inertia_zz" in page.text
    assert twin.name in page.text


def test_poses_at_other_times_are_not_drawn(tmp_path):
    write_push(tmp_path / "capture")
    write_identified(tmp_path / "twin", tmp_path / "capture")
    path = tmp_path / "twin/episodes/0000.csv"
    path.write_text("".join(path.read_text().splitlines(keepends=True)[:-1]))
    notices = read_story(tmp_path / "twin").notices
    assert [notice for notice in notices if "3 identified poses are not at the times of the 4 frames" in notice]


def test_histories_are_checked(tmp_path):
    path = tmp_path / "history.npz"
    with pytest.raises(InputError, match="no such file"):
        read_history(path)
    write_history(path)
    history = read_history(path)
    assert [number for number, _ in history.starts()] == [0, 1]
    assert history.stage_begins() == [(0.0, "coarse"), (3.0, "fine")]
    for arrays, message in (
        ({"theta": np.zeros((12, 3))}, r"theta of shape \(12, 3\)"),
        ({"loss": np.array(["a"] * 12)}, "loss of type"),
        ({"names": np.array([{}, []], object)}, "names. of object .* no pickles"),
    ):
        write_history(path, **arrays)
        with pytest.raises(InputError, match=message):
            read_history(path)
    np.savez(path, loss=np.zeros(3))
    with pytest.raises(InputError, match="no array iteration"):
        read_history(path)


@pytest.mark.parametrize("rows", [0, 1])
def test_a_short_or_diverged_history_can_be_drawn(tmp_path, rows):
    write_history(
        tmp_path / "history.npz",
        loss=np.full(rows, np.nan),
        iteration=np.arange(rows),
        stage=np.zeros(rows, int),
        theta=np.full((rows, 2), np.inf),
        start=np.zeros(rows, int),
    )
    history = read_history(tmp_path / "history.npz")
    figures = [loss_figure(history), theta_figure(history, estimates(), {"friction_floor": 0.1})]
    assert [data_uri(figure)[:19] for figure in figures] == ["data:image/svg+xml;"] * 2


def test_errors_of_poses():
    # The truth is known at other times, and moves evenly: 10 mm and 0.02 rad in each 0.1 s.
    n = 5
    t = 0.1 * np.arange(n)
    turn = torch.zeros(n, 3, dtype=torch.float64)
    turn[:, 2] = torch.from_numpy(0.2 * t)
    truth = ObjectPoses(t, np.stack([0.1 * t, 0 * t, 0 * t], -1), quaternion_exp(turn).numpy())
    at = np.array([-0.1, 0.05, 0.25, 0.5])
    tilt = quaternion_exp(torch.tensor([[0.3, 0.0, 0.0]] * 4, dtype=torch.float64)).numpy()
    # Height does not count in the plane; the sign of a quaternion means nothing.
    poses = ObjectPoses(at, np.stack([0.1 * at + 3e-3, 4e-3 + 0 * at, 1 + 0 * at], -1), -tilt)
    errors = pose_errors(poses, truth)
    assert errors.t.tolist() == [0.05, 0.25]
    np.testing.assert_allclose(errors.position, 5e-3, rtol=1e-9)
    # cos(angle / 2) of a turn by a about x after one by b about z is cos(a / 2) cos(b / 2).
    expected = 2 * np.arccos(np.cos(0.15) * np.cos(0.1 * errors.t))
    np.testing.assert_allclose(errors.rotation, expected, rtol=1e-9)
    assert "position 5.00 mm on average, 5.00 mm at most" in errors.words()
    assert pose_errors(ObjectPoses(at[:1], poses.p_WO[:1], poses.q_WO[:1]), truth) is None


def test_renderings_at_the_true_poses_are_the_images(folder):
    capture = load_capture(folder / "capture")
    episode = read_episode(capture, "0000")
    cast = Cast.of(write_identified(folder / "exact", folder / "capture"), 0)
    for k, poses in ((0, moved(4)), (3, moved(4))):
        picture = draw_frame(episode, k, poses, cast)
        # 8 bits a channel; where alpha is cut off at 1/2, a pixel can be white in the image.
        assert picture.overlap() == 1.0
        seen = picture.mask
        assert np.abs(picture.image - picture.rendered)[seen].max() <= 1 / 255
        assert picture.hidden.any()
        assert not (picture.hidden & seen).any()
    window = window_of(episode, moved(4), cast)
    assert 0 <= window[0].start < window[0].stop <= episode.camera.height
    aside = draw_frame(episode, 3, moved(4, by=0.03), cast)
    assert aside.overlap() < 0.7
    shots = draw_shots(episode, moved(4), cast, size=20, most=2)
    assert [shot.t for shot in shots] == [0.0, pytest.approx(0.3)]
    assert all(panel.shape == shots[0].panels[0].shape for shot in shots for panel in shot.panels)
    height, width, _ = shots[0].panels[0].shape
    assert max(height, width) <= 20
    assert height % 2 == width % 2 == 0


def test_films_show_the_pusher_where_its_log_has_it(folder):
    capture = load_capture(folder / "capture")
    episode = read_episode(capture, "0000")
    cast = Cast.of(write_identified(folder / "exact", folder / "capture"), 0)
    picture = draw_frame(episode, 0, moved(4), cast)
    p_C = transform(inverse(episode.X_WC), episode.pusher_pose(0.0).p[None])[0]
    fx, fy, cx, cy = episode.camera.intrinsics.tolist()
    there = np.array([fy * p_C[1] / p_C[2] + cy, fx * p_C[0] / p_C[2] + cx])
    free = picture.hidden & picture.pusher_nearest & ~picture.covered
    assert free.any()
    # The capsule's ends are 30 mm from its middle.
    assert np.linalg.norm(np.argwhere(free) + 0.5 - there, axis=1).max() < fx * 0.032 / float(p_C[2])
    for shown, before in ((picture.shown_image(), picture.image), (picture.shown_rendering(), picture.rendered)):
        assert (shown[free][:, 2] > shown[free][:, 0] + 0.1).all()
        changed = np.abs(shown - before).max(axis=2) > 0.01
        assert changed[free].all()
        assert not changed[~(picture.hidden | picture.pusher_nearest)].any()
    # One that is behind the object, as the twin has it, is hidden there; one in front hides it.
    middle = moved(4).p_WO[0]
    for towards, seen in ((-0.3, False), (0.3, True)):
        p_WP = middle + towards * (episode.X_WC.p.numpy() - middle)
        log = replace(episode.trajectory, p_WP=np.tile(p_WP, (len(episode.trajectory.t), 1)))
        placed = draw_frame(replace(episode, trajectory=log), 0, moved(4), cast)
        assert (placed.pusher_nearest & placed.covered).any() == seen
    cast = replace(cast, actors=None)
    np.testing.assert_array_equal(draw_frame(episode, 0, moved(4), cast).shown_rendering(), picture.rendered)
    # The window of a film has all of it.
    rows, columns = window_of(episode, moved(4), cast)
    assert not picture.pusher_nearest[: rows.start].any()
    assert not picture.pusher_nearest[:, : columns.start].any()


def test_an_outline_ends_where_nothing_is_on_the_other_side():
    # Two squares side by side: the edge between them is no boundary, and 6 of 8 edges are left.
    square = np.array([[[0, 0], [1, 0], [1, 1]], [[0, 0], [1, 1], [0, 1]]], float)
    triangles = np.concatenate([square, square + np.array([1, 0])])
    corners = np.array([[0, 0], [1, 0], [1, 1], [0, 1]], float)
    edges = np.stack([corners, np.roll(corners, -1, axis=0)], axis=1)
    kept = boundary(triangles, np.concatenate([edges, edges + np.array([1, 0])]))
    assert np.linalg.norm(kept[:, 1] - kept[:, 0], axis=1).sum() == pytest.approx(6)
    assert not (np.abs(kept[..., 0] - 1.0) < 1e-9).all(axis=1).any()


def test_ground_truth_has_the_names_of_a_twin(tmp_path):
    path = tmp_path / "ground_truth.yaml"
    path.write_text("mass: 1\nrestitution: 0.2\nrestitution_pusher: 3e-1\ninertia_xy: 0.0\nfriction_floor: null\n")
    assert read_ground_truth(path) == {"mass": 1.0, "restitution_floor": 0.2, "restitution_pusher": 0.3}


def test_starts_agree_by_the_stage_that_all_of_them_go_through(tmp_path):
    # Start 1 alone is refined, to half of the loss of the others.
    stage = np.array(["coarse", "coarse", "coarse", "coarse", "fine", "fine"])
    start, loss = np.array([0, 0, 1, 1, 1, 1]), np.array([0.2, 0.102, 0.3, 0.1, 0.08, 0.05])
    arrays = {"iteration": np.array([0, 1, 0, 1, 2, 3]), "theta": np.zeros((6, 2)), "stage": stage, "start": start}
    path = tmp_path / "history.npz"
    for losses, words in (
        (loss, "All 2 random starts agree within 5 %; the loss at the end is 0.05."),
        (
            np.where(start == 0, 2.0 * loss, loss),
            "Of 2 random starts, 1 agree within 5 %; the loss at the end is 0.05.",
        ),
        (np.full(6, np.nan), ""),
    ):
        write_history(path, loss=losses, **arrays)
        assert _starts_words(read_history(path)) == words
    write_history(path, loss=loss, **(arrays | {"start": np.zeros(6, int), "iteration": np.arange(6)}))
    assert _starts_words(read_history(path)) == "There was 1 random start; the loss at the end is 0.05."


def test_numbers_have_the_digits_that_their_intervals_leave():
    def row(*estimate) -> str:
        return Page(MACROS.estimates({"x": Estimate(*estimate)}, {})).text.split("note ")[1]

    assert row(0.0302134, (0.0291, 0.0313), True, "1") == "x 0.0302 0.0291 to 0.0313 yes"
    assert row(0.030213456, (0.030213, 0.030214), True, "kg") == "x 0.030213 0.030213 to 0.030214 kg yes"
    assert row(0.01, None, False, "m", "why") == "x 10 – mm no why"
    assert row(0.0, (-np.inf, np.inf), False, "m") == "x 0 −∞ to ∞ mm no"


def test_pieces_of_a_page():
    assert Page(MACROS.tree({"a": [1, 2.5], "b": {"c": None, "d": True}, "e": [], "f": [{"g": 1}]})).text == (
        "a 1, 2.5 b c none d yes e none f 0 g 1"
    )
    page = templates.get_template("report/base.html").render(title="{{ marzipan }}", about="<b>", marzipan="bread")
    assert "<h1>{{ marzipan }}</h1>" in page
    assert '<p class="about">&lt;b&gt;</p>' in page
    with pytest.raises(UndefinedError, match="'about' is undefined"):
        templates.get_template("report/base.html").render(title="")


def test_a_frame_that_is_not_told_apart_is_a_notice(tmp_path):
    write_push(tmp_path / "capture")
    twin = write_identified(tmp_path / "twin", tmp_path / "capture")
    note = "frame and centre of mass cannot be told apart along 90°"
    write_twin(tmp_path / "twin", replace(twin, provenance=twin.provenance | {"frame": {"note": note}}))
    assert note in read_story(tmp_path / "twin").notices
