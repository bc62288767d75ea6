# SPDX-License-Identifier: MIT
import json
import multiprocessing
import re
import shutil
from html.parser import HTMLParser

import pytest

from pinwm_drake.demo.kernels import compiling
from pinwm_drake.demo.main import run_demo
from pinwm_drake.demo.options import DemoOptions, shipped_capture
from pinwm_drake.errors import InputError
from pinwm_drake.identification.options import IdentifyOptions
from pinwm_drake.rendering.fit_options import FitOptions
from pinwm_drake.twin.read import load_twin
from pinwm_drake.twin.twin import THETA

MAX_STEPS = 5
FRAMES = 24
# Far too little for a good twin: here it counts that every stage hands on what the next one needs.
TINY = DemoOptions(
    fit=FitOptions(iterations=20, max_surfels=200, sh_degree=0, num_threads=1),
    identify=IdentifyOptions(
        support="corners",
        screened=4,
        starts=1,
        coarse_iterations=2,
        fine_iterations=1,
        moves=4,
        coarse_size=16.0,
        fine_size=24.0,
        coarse_frames=4,
        num_threads=1,
    ),
    max_steps=MAX_STEPS,
)


class Page(HTMLParser):
    """What a page refers to, and its text."""

    def __init__(self, contents):
        super().__init__()
        self.tags, self.sources, self.links, self.words = [], [], [], []
        self.feed(contents)

    def handle_starttag(self, tag, attrs):
        attrs = dict(attrs)
        self.tags.append((tag, attrs))
        self.sources += [attrs[name] for name in ("src", "srcset", "data", "poster", "action") if name in attrs]
        if "href" in attrs:
            self.links.append((tag, attrs["href"]))

    def handle_data(self, data):
        self.words.append(data)


@pytest.fixture(scope="module")
def out(tmp_path_factory):
    folder = tmp_path_factory.mktemp("demo")
    (folder / "index.html").write_text("of an earlier run")
    run_demo(folder, TINY)
    return folder


@pytest.fixture(scope="module")
def contents(out):
    return (out / "index.html").read_text()


@pytest.fixture(scope="module")
def page(contents):
    return Page(contents)


def films(contents):
    return [json.loads(found) for found in re.findall(r'<script type="application/json">(.*?)</script>', contents)]


@pytest.mark.nightly
def test_the_page_loads_nothing(contents, page):
    assert page.sources
    assert all(source.startswith("data:image/") for source in page.sources)
    assert not [tag for tag, _ in page.tags if tag in ("link", "iframe", "object", "embed", "video")]
    assert not re.search(r"https?:|@import|url\(", contents)
    assert all(frame["src"].startswith("data:image/") for film in films(contents) for frame in film)


@pytest.mark.nightly
def test_links_lead_to_files_that_are_there(out, page):
    assert {tag for tag, _ in page.links} == {"a"}
    links = [href for _, href in page.links]
    assert {"twin/report.html", "twin/view.html", "twin/twin.yaml", "prediction/0001.csv"} <= set(links)
    assert [href for href in links if not (out / href).exists()] == []


@pytest.mark.nightly
def test_the_page_shows_every_parameter_beside_the_truth(contents):
    for name in THETA:
        row = re.search(rf'<tr><td class="key">{name}</td>.*?</tr>', contents)
        assert row is not None, name
    (friction,) = re.findall(r'<tr><td class="key">friction_floor</td>.*?</tr>', contents)
    # `pinwm capture simulate` was run with this one.
    assert ">0.03<" in friction


@pytest.mark.nightly
def test_the_page_shows_both_pushes_and_the_policy(contents):
    identified, predicted, policy = films(contents)
    assert [len(identified), len(predicted)] == [FRAMES, FRAMES]
    assert all("from the truth" in frame["words"] for frame in (*identified, *predicted))
    # The start and one frame after each action.
    assert len(policy) == MAX_STEPS + 1
    assert policy[-1]["words"].startswith("twin: action ")
    assert "hydroelastic: action " in policy[-1]["words"]


@pytest.mark.nightly
def test_the_page_tells_the_seconds_of_each_stage_and_how_to_go_on(page):
    words = " ".join(page.words)
    for stage in ("align", "identify", "report", "predict", "policy, twin", "policy, hydroelastic", "films"):
        assert stage in page.words
    assert "pinwm identify mycapture out/mytwin" in words


@pytest.mark.nightly
def test_the_folder_holds_a_twin_that_other_commands_take(out):
    twin = load_twin(out / "twin")
    assert twin.provenance["episode"] == "0000"
    for name in ("identified", "predicted", "policy"):
        assert (out / f"films/{name}.mp4").stat().st_size > 1000


def test_a_capture_of_one_push_is_refused_and_leaves_no_page(tmp_path):
    capture, out = tmp_path / "capture", tmp_path / "out"
    shutil.copytree(shipped_capture(), capture)
    shutil.rmtree(capture / "episodes/0001")
    out.mkdir()
    (out / "index.html").write_text("of an earlier run")
    with pytest.raises(InputError, match="got 1 episodes; allowed: a capture with two or more"):
        run_demo(out, DemoOptions(capture=capture))
    assert not (out / "index.html").exists()


def test_a_capture_with_an_error_is_refused(tmp_path):
    capture = tmp_path / "capture"
    shutil.copytree(shipped_capture(), capture)
    (capture / "episodes/0000/rgb/00003.png").unlink()
    with pytest.raises(InputError, match=r"00003\.png"):
        run_demo(tmp_path / "out", DemoOptions(capture=capture))


@pytest.mark.nightly
def test_the_second_process_compiles_and_tells_what_it_took():
    with compiling(shipped_capture(), TINY.identify) as wait:
        cost = wait()
    assert cost is not None
    assert cost.cpu_seconds > 0


def test_a_second_process_that_fails_stops_nothing(tmp_path):
    with compiling(tmp_path, TINY.identify) as wait:
        assert wait() is None


def test_the_second_process_ends_with_the_block():
    others = set(multiprocessing.active_children())
    with compiling(shipped_capture(), TINY.identify):
        (process,) = set(multiprocessing.active_children()) - others
        assert process.is_alive()
    assert not process.is_alive()


def test_options_of_the_main_job_are_refused_before_a_subcommand(pinwm, tmp_path):
    code, _, errors = pinwm("demo", "--out", str(tmp_path / "out"), "push")
    assert code == 1
    assert errors == f"pinwm: --out: got {tmp_path / 'out'} before push; allowed: behind it, as its own option\n"


def test_demo_writes_to_the_folder_that_is_named(pinwm, tmp_path):
    file = tmp_path / "file"
    file.write_text("")
    code, output, errors = pinwm("demo", "--out", str(file))
    assert (code, output) == (1, "")
    assert errors == f"pinwm: {file}: got File exists; allowed: a folder that can be written to\n"
