# SPDX-License-Identifier: MIT
import json
import os
import re
import subprocess
import sys
from pathlib import Path

import cv2
import numpy as np
import pytest
import trimesh

from pinwm_drake.experiments import alignment
from pinwm_drake.rendering.ply import read_ply
from pinwm_drake.report.live.page import PAGE_FILE, PICTURE_FILE, ProgressPage
from tests.capture.cube import HEIGHT, SIDE, write_capture, write_views

ROOT = Path(__file__).resolve().parents[2]
SMALL = ["--max-surfels", "120", "--sh-degree", "1"]
BRIEF = ["--iterations", "30", *SMALL]
CONFIG = "align.config.yaml"
RESULTS = [CONFIG, "align.json", "align.png", "checkpoint.npz", "surfels.ply", "turntable.mp4", "view.html"]


@pytest.fixture(scope="module")
def capture(tmp_path_factory):
    return write_capture(tmp_path_factory.mktemp("align") / "cube")


@pytest.mark.parametrize("command", ["align", "view"])
def test_help_shows_an_example(pinwm, command):
    code, output, _ = pinwm(command, "--help")
    assert code == 0
    assert f"Example: pinwm {command} " in output


def test_align_writes_surfels_figures_video_and_page(pinwm, capture, tmp_path):
    out = tmp_path / "new/folder"
    code, output, errors = pinwm("align", str(capture), str(out), "--iterations", "60", *SMALL)
    assert (code, errors) == (0, "")
    assert sorted(path.name for path in out.iterdir()) == RESULTS
    for name in set(RESULTS) - {"checkpoint.npz", CONFIG}:
        assert f"wrote {out / name}\n" in output
    assert re.search(r"held out +│ 2 ", output)

    surfels = read_ply(out / "surfels.ply")
    assert surfels.degree == 1
    # The object's frame is that of the mesh, with its origin in the middle of the cube.
    np.testing.assert_allclose(surfels.p_OS.mean(0), 0, atol=0.1 * SIDE)
    assert surfels.p_OS.abs().max() < SIDE

    record = json.loads((out / "align.json").read_text())
    assert record["num_surfels"] == surfels.num_surfels <= 120
    assert list(record["views"]["held_out"]) == ["images/003.png", "images/007.png"]
    assert record["psnr"]["held_out"] == pytest.approx(np.mean(list(record["views"]["held_out"].values())))
    # A white picture has 14 dB here.
    assert record["psnr"]["fitted"] > 16
    assert record["options"]["iterations"] == 60
    assert record["source"] == str(capture)

    assert cv2.imread(str(out / "align.png")).std() > 10
    assert cv2.VideoCapture(str(out / "turntable.mp4")).get(cv2.CAP_PROP_FRAME_WIDTH) == 48
    assert "renderSurfels" in (out / "view.html").read_text()


def test_a_live_page_shows_the_fit_and_does_not_change_it(pinwm, capture, tmp_path, monkeypatch):
    arguments = ["--iterations", "12", *SMALL]
    seen, update = [], ProgressPage.update

    def watched(self, *call):
        update(self, *call)
        if (tmp_path / "shown" / PAGE_FILE).exists():
            seen.append((tmp_path / "shown" / PAGE_FILE).read_text())

    monkeypatch.setattr(ProgressPage, "update", watched)
    code, output, errors = pinwm("align", str(capture), str(tmp_path / "shown"), *arguments, "--view")
    assert (code, errors) == (0, "")
    assert f"open {tmp_path / 'shown' / PAGE_FILE} in a browser" in output
    assert 'http-equiv="refresh"' in seen[0]
    assert "8 %, 1/12  loss " in seen[0]
    page = (tmp_path / "shown" / PAGE_FILE).read_text()
    assert "refresh" not in page
    assert "100 %, 12/12" in page
    assert cv2.imread(str(tmp_path / "shown" / PICTURE_FILE)).std() > 10
    assert pinwm("align", str(capture), str(tmp_path / "plain"), *arguments)[0] == 0
    assert not (tmp_path / "plain" / PAGE_FILE).exists()
    for name in ("surfels.ply", "view.html"):
        assert (tmp_path / "shown" / name).read_bytes().replace(b"shown", b"plain") == (
            tmp_path / "plain" / name
        ).read_bytes()


def test_a_bare_folder_needs_a_mesh_and_no_held_out_views(pinwm, tmp_path):
    views = write_views(tmp_path / "views", count=4, size=32, alpha=False)
    command = ["align", str(views), str(tmp_path / "out"), "--iterations", "5", "--held-out", "0", *SMALL]
    code, output, errors = pinwm(*command)
    assert (code, output) == (1, "")
    assert (
        errors == f"pinwm: --mesh: got none; allowed: the object's mesh, as {views} is no capture with one of its own\n"
    )
    mesh = tmp_path / "cube.obj"
    standing = trimesh.creation.box((SIDE, SIDE, SIDE))
    standing.apply_translation([0.0, 0.0, HEIGHT]).export(mesh)
    code, output, errors = pinwm(*command, "--mesh", str(mesh))
    assert (code, errors) == (0, "")
    record = json.loads((tmp_path / "out/align.json").read_text())
    assert record["psnr"]["held_out"] is None
    assert len(record["views"]["fitted"]) == 4


@pytest.mark.parametrize(
    ("change", "found"),
    [
        (lambda mesh: mesh.apply_scale(0.7), r"misses the masks in 8 of 8 views; images/\d+\.png: overlap"),
        (lambda mesh: mesh.apply_translation([0.0, 0.0, 0.03]), "misses the masks"),
        (lambda mesh: mesh.apply_translation([0.02, 0.0, 0.0]), "a mesh that is 20 mm from where the masks"),
        (lambda mesh: mesh.apply_scale(0.9), r"the masks show 1\.1[0-3] times as large and [+-][01] mm in height"),
        (lambda mesh: mesh.apply_translation([0.0, 0.0, 0.01]), r"the masks show 1\.0\d times as large and -10 mm"),
        *(
            pytest.param(*case, marks=pytest.mark.nightly)
            for case in (
                (lambda mesh: mesh.apply_scale(1.4), r"misses the masks in \d of 8 views"),
                (lambda mesh: mesh.apply_scale([1.0, 0.4, 1.0]), "misses the masks"),
                (lambda mesh: mesh.apply_scale(1.1), r"the masks show 0\.9[0-3] times as large and [+-][01] mm"),
            )
        ),
    ],
)
def test_a_mesh_that_does_not_fit_its_masks_is_refused_before_the_fit(pinwm, tmp_path, monkeypatch, change, found):
    capture = write_capture(tmp_path / "cube")
    mesh = trimesh.creation.box((SIDE, SIDE, SIDE))
    change(mesh)
    mesh.export(capture / "meshes/object.obj")
    monkeypatch.setattr(alignment, "fit", lambda *_, **__: pytest.fail("the fit began"))
    code, _, errors = pinwm("align", str(capture), str(tmp_path / "out"), *SMALL)
    assert code == 1
    assert re.search(found, errors)
    assert errors.count("\n") == 1
    assert "object.obj: got a mesh" in errors
    assert "; allowed: " in errors


@pytest.fixture(scope="module")
def whole(pinwm, capture, tmp_path_factory):
    """surfels.ply of a fit that nothing interrupts."""
    out = tmp_path_factory.mktemp("whole")
    assert pinwm("align", str(capture), str(out), *BRIEF)[0] == 0
    return (out / "surfels.ply").read_bytes()


def run_script(code: str, capture: Path, out: Path, *arguments: str) -> subprocess.CompletedProcess:
    """Runs `pinwm align` with 30 iterations in a process of its own, with some code around it."""
    command = ["align", str(capture), str(out), *BRIEF, *arguments]
    lines = [
        "import os, resource, sys",
        "from pinwm_drake.cli import main",
        "from pinwm_drake.experiments import alignment",
        "alignment._CHECKPOINT_EVERY = 20",
        f"sys.argv = ['pinwm', *{command}]",
    ]
    program = "\n".join([*lines, code])
    return subprocess.run([sys.executable, "-c", program], cwd=ROOT, capture_output=True, text=True)


@pytest.fixture
def goes_on(pinwm, capture, whole, tmp_path):
    """Checks that --resume leads to what a fit that nothing interrupts makes."""

    def check():
        code, _, errors = pinwm("align", str(capture), str(tmp_path), *BRIEF, "--resume")
        assert (code, errors) == (0, "")
        assert sorted(os.listdir(tmp_path)) == RESULTS
        assert (tmp_path / "surfels.ply").read_bytes() == whole

    return check


def test_a_fit_that_ctrl_c_ended_goes_on_as_if_it_had_not_been(pinwm, capture, goes_on, tmp_path, monkeypatch):
    fit = alignment.fit

    def interrupted(*arguments, progress, **options):
        def told(iteration, *figures):
            progress(iteration, *figures)
            if iteration == 25:
                raise KeyboardInterrupt

        return fit(*arguments, progress=told, **options)

    monkeypatch.setattr(alignment, "_CHECKPOINT_EVERY", 20)
    with monkeypatch.context() as patch:
        patch.setattr(alignment, "fit", interrupted)
        code, output, errors = pinwm("align", str(capture), str(tmp_path), *BRIEF)
    assert (code, errors) == (1, "")
    assert "interrupted after iteration 25; go on with --resume" in output
    assert sorted(os.listdir(tmp_path)) == [CONFIG, "checkpoint.npz"]
    goes_on()


KILL = """
fit = alignment.fit
def killed(*arguments, progress, **options):
    def told(iteration, *figures):
        progress(iteration, *figures)
        if iteration == 25:
            os.kill(os.getpid(), 9)
    return fit(*arguments, progress=told, **options)
alignment.fit = killed
main()
"""


@pytest.mark.nightly
def test_a_killed_fit_goes_on_as_if_it_had_not_been(capture, goes_on, tmp_path):
    run = run_script(KILL, capture, tmp_path)
    assert run.returncode == -9, run.stderr
    # It leaves its lock, which the next one takes over.
    assert sorted(os.listdir(tmp_path)) == [".pinwm.lock", "checkpoint.npz"]
    goes_on()


FULL_DISK = """
write_results = alignment.write_fit_results
def write(*arguments):
    resource.setrlimit(resource.RLIMIT_FSIZE, ({limit}, {limit}))
    return write_results(*arguments)
alignment.write_fit_results = write
main()
"""


@pytest.mark.nightly
def test_a_disk_that_fills_up_at_the_end_loses_nothing(capture, whole, tmp_path):
    # The PLY of 120 surfels has 20 kB, and the page some more.
    for limit, left, missing in ((1000, ["checkpoint.npz"], "surfels.ply"), (20000, None, "align.png")):
        run = run_script(FULL_DISK.format(limit=limit), capture, tmp_path, *(["--resume"] if left is None else []))
        assert run.returncode == 1
        assert run.stderr == f"pinwm: {tmp_path / missing}: got File too large; allowed: a file that can be written\n"
        assert sorted(os.listdir(tmp_path)) == (left or ["align.json", "checkpoint.npz", "surfels.ply"])
    # What was fitted was still there.
    assert (tmp_path / "surfels.ply").read_bytes() == whole


def test_resuming_nothing_says_so_and_another_fit_is_refused(pinwm, capture, tmp_path):
    code, output, _ = pinwm("align", str(capture), str(tmp_path), "--iterations", "3", *SMALL, "--resume")
    assert code == 0
    assert f"no checkpoint.npz in {tmp_path}: starting anew\n" in output
    code, _, errors = pinwm("align", str(capture), str(tmp_path), "--iterations", "4", *SMALL, "--resume")
    assert code == 1
    assert f"pinwm: {tmp_path / 'checkpoint.npz'}: got a fit with iterations = 3; allowed: one with" in errors


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (["--iterations", "0"], "--iterations: got 0; allowed: 1 to"),
        (["--max-surfels", "0"], "--max-surfels: got 0"),
        (["--sh-degree", "4"], "--sh-degree: got 4; allowed: 0 to 3"),
        (["--held-out", "1"], "--held-out: got 1"),
        (["--seed", "-1"], "--seed: got -1"),
        (["--threads", "0"], "--threads: got 0"),
        (["--mesh", "nothing.obj"], "nothing.obj: no such file"),
    ],
)
def test_wrong_options_are_one_line_and_exit_with_1(pinwm, capture, tmp_path, arguments, message):
    code, output, errors = pinwm("align", str(capture), str(tmp_path / "out"), *arguments)
    assert (code, output) == (1, "")
    assert re.fullmatch(rf"pinwm: {re.escape(message)}.*\n", errors)
    assert not (tmp_path / "out").exists()


def test_a_source_that_is_none_is_refused(pinwm, tmp_path):
    out = str(tmp_path / "out")
    allowed = "allowed: a capture, or images with a nerfstudio transforms.json"
    assert pinwm("align", str(tmp_path / "a"), out) == (
        1,
        "",
        f"pinwm: {tmp_path / 'a'}: no such file or folder; {allowed}\n",
    )
    code, _, errors = pinwm("align", str(tmp_path), out)
    assert (code, errors) == (1, f"pinwm: {tmp_path}: got neither capture.yaml nor transforms.json; {allowed}\n")


def test_a_capture_with_a_truncated_image_is_refused_in_one_line(pinwm, tmp_path):
    capture = write_capture(tmp_path / "cube", count=3)
    image = capture / "static/images/001.png"
    image.write_bytes(image.read_bytes()[:300])
    code, output, errors = pinwm("align", str(capture), str(tmp_path / "out"))
    assert (code, output) == (1, "")
    assert re.fullmatch(
        rf"pinwm: {re.escape(str(image))}: got unreadable contents .*; allowed: a whole image file\n", errors
    )


def test_a_place_that_cannot_be_written_is_refused_before_the_fit(pinwm, capture, tmp_path, monkeypatch):
    monkeypatch.setattr(alignment, "fit", lambda *_: pytest.fail("the fit has started"))
    (tmp_path / "file").write_text("")
    code, _, errors = pinwm("align", str(capture), str(tmp_path / "file"))
    assert (code, errors) == (
        1,
        f"pinwm: {tmp_path / 'file'}: got File exists; allowed: a folder that can be written to\n",
    )
    monkeypatch.setattr(alignment.shutil, "disk_usage", lambda _: type("Usage", (), {"free": 1_000_000}))
    code, _, errors = pinwm("align", str(capture), str(tmp_path / "out"))
    assert (code, errors) == (1, f"pinwm: {tmp_path / 'out'}: got 1 MB of free space; allowed: 44 MB or more\n")
