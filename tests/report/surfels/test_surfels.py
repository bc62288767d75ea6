# SPDX-License-Identifier: MIT
import json
import math
import re
import shutil
import subprocess
import sys
from pathlib import Path

import cv2
import numpy as np
import pytest
import torch

from pinwm_drake.errors import InputError, RenderingError
from pinwm_drake.rendering.render import render
from pinwm_drake.rendering.surfels import Surfels
from pinwm_drake.report.figures.align import Strip, align_figure
from pinwm_drake.report.orbit import AZIMUTH, ELEVATION, FIELD_OF_VIEW, Orbit, square_camera
from pinwm_drake.report.surfels.mesh import CORNERS, GAUSSIAN, SurfelMesh, linear
from pinwm_drake.report.surfels.page import write_surfel_page
from pinwm_drake.report.surfels.turntable import to_bytes, turntable
from pinwm_drake.spatial.poses import transform
from pinwm_drake.spatial.rotations import normalize_quaternion, quaternion_to_matrix

ROOT = Path(__file__).resolve().parents[3]


def cloud(count: int = 40, degree: int = 3, seed: int = 0) -> Surfels:
    """Surfels at random within 5 cm of a point."""
    numbers = torch.Generator().manual_seed(seed)

    def normal(*shape: int) -> torch.Tensor:
        return torch.randn(*shape, generator=numbers)

    return Surfels(
        p_OS=0.02 * normal(count, 3).clamp(-2, 2) + torch.tensor([0.3, -0.1, 0.05]),
        q_OS=normal(count, 4),
        log_scale=math.log(0.006) + 0.7 * normal(count, 2),
        logit_opacity=1 + 2 * normal(count),
        sh=0.4 * normal(count, (degree + 1) ** 2, 3),
    )


def test_an_orbit_sees_its_target_in_the_middle_and_all_surfels_in_the_picture():
    surfels, camera = cloud(), square_camera(100)
    up = np.array([0.0, 2.0, 0.0])
    for orbit in (Orbit.around(surfels), Orbit.around(surfels, up)):
        for azimuth in (0.0, 2.0, -2.0):
            X_CO = orbit.pose(azimuth, ELEVATION)
            target = transform(X_CO, torch.tensor(orbit.target))
            np.testing.assert_allclose(target, [0, 0, orbit.distance], atol=1e-12)
            p_C = transform(X_CO, surfels.p_OS.double())
            pixels = camera.intrinsics[:2] * p_C[:, :2] / p_C[:, 2:] + camera.intrinsics[2:]
            assert 0 < pixels.min() < pixels.max() < 100
            above = transform(X_CO, torch.tensor(orbit.target + 0.01 * orbit.up))
            assert above[1] < 0
            assert abs(above[0]) < 1e-12


def test_an_orbit_turns_counter_clockwise_as_its_azimuth_grows():
    orbit = Orbit(np.zeros(3), 1.0, np.array([0.0, 0, 1]))
    # The camera at azimuth a, elevation 0 stands at (cos a, sin a, 0) and has z up: its x is (-sin a, cos a, 0).
    for a in (0.0, 0.7):
        p_C = transform(orbit.pose(a, 0.0), torch.tensor([-math.sin(a), math.cos(a), 0.0], dtype=torch.float64))
        np.testing.assert_allclose(p_C, [1, 0, 1], atol=1e-12)


def test_nothing_to_look_at_is_refused():
    empty = Surfels(*(value[:0] for value in cloud().tensors().values()))
    with pytest.raises(RenderingError, match="there are 0 surfels"):
        Orbit.around(empty)


def test_a_turntable_has_all_its_frames():
    shares: list[float] = []
    surfels = cloud()
    frames = list(turntable(surfels, size=32, num_frames=5, report=shares.append))
    assert [frame.shape for frame in frames] == [(32, 32, 3)] * 5
    assert shares == pytest.approx([0.2, 0.4, 0.6, 0.8, 1.0])
    first = render(surfels, square_camera(32), Orbit.around(surfels).pose(AZIMUTH, ELEVATION), full=False)
    np.testing.assert_array_equal(frames[0], to_bytes(first.color[0]))
    assert all(frame[0, 0].min() == 255 and frame[8:24, 8:24].min() < 200 for frame in frames)
    assert not np.array_equal(frames[0], frames[1])


def test_a_mesh_of_surfels_has_their_planes_sizes_colours_and_opacities():
    surfels = cloud(degree=1)
    surfels.logit_opacity[3] = -4.0
    mesh = SurfelMesh.from_surfels(surfels)
    opacity = surfels.logit_opacity.double().sigmoid().numpy()
    kept, hides = np.flatnonzero(opacity >= 0.05), np.flatnonzero(opacity > 0.5)
    assert 0 < len(hides) < len(kept) < surfels.num_surfels
    cores, rims = mesh.core_vertices.reshape(-1, CORNERS, 3), mesh.rim_vertices.reshape(-1, 4, 3)
    assert (len(cores), len(rims)) == (len(hides), len(kept))
    R_OS = quaternion_to_matrix(normalize_quaternion(surfels.q_OS.double())).numpy()
    scale, p_OS = surfels.log_scale.double().exp().numpy(), surfels.p_OS.double().numpy()
    # Alpha is half at the edge of a core, in every direction.
    offsets = np.einsum("nij,nki->nkj", R_OS[hides], cores - p_OS[hides][:, None])
    u = offsets[..., :2] / scale[hides][:, None]
    alpha = opacity[hides][:, None] * np.exp(-0.5 * (u**2).sum(axis=-1))
    np.testing.assert_allclose(alpha, 0.5, rtol=1e-3)
    np.testing.assert_allclose(offsets[..., 2], 0, atol=1e-7)
    # A rim reaches as far as its texture has the Gaussian.
    u = np.einsum("nij,nki->nkj", R_OS[kept], rims - p_OS[kept][:, None])[..., :2] / scale[kept][:, None]
    np.testing.assert_allclose(u, np.broadcast_to(2.5 * (2 * mesh.rim_uv[:4] - 1), u.shape), atol=1e-3)
    side = len(GAUSSIAN)
    at = 2.5 * (2 * (np.arange(side) + 0.5) / side - 1)
    np.testing.assert_allclose(GAUSSIAN[side // 2, :, 3] / 255, np.exp(-0.5 * (at**2 + at[side // 2] ** 2)), atol=0.05)
    for vertices, faces, count in ((cores, mesh.core_faces, CORNERS), (rims, mesh.rim_faces, 4)):
        corners = vertices.reshape(-1, 3)[faces].astype(float)
        around = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
        normals = R_OS[hides if count == CORNERS else kept][faces[:, 0] // count][:, :, 2]
        assert (np.einsum("ij,ij->i", around, normals) > 0).all()
    colours = (0.5 + 0.28209479 * surfels.sh[:, 0].numpy()).clip(0, 1)
    np.testing.assert_allclose(mesh.core_colours[::CORNERS], colours[hides], atol=1e-6)
    np.testing.assert_allclose(mesh.rim_colours[::4], np.column_stack((colours, opacity))[kept], atol=1e-6)


def test_sheets_have_linear_colours():
    mesh = SurfelMesh.from_surfels(cloud())
    cores, rims = mesh.sheets()
    assert rims.blend
    assert not cores.blend
    np.testing.assert_array_equal(rims.colours[:, 3], mesh.rim_colours[:, 3])
    # The standard's own pair: half of the scale is 0.214 of the light.
    np.testing.assert_allclose(linear(np.array([[0.5, 0.0, 1.0]])), [[0.21404, 0.0, 1.0]], atol=1e-5)


def test_faint_surfels_are_rims_when_there_are_no_others():
    surfels = cloud()
    faint = Surfels(surfels.p_OS, surfels.q_OS, surfels.log_scale, torch.full((40,), -4.0), surfels.sh)
    mesh = SurfelMesh.from_surfels(faint)
    assert len(mesh.rim_vertices) == 40 * 4
    assert len(mesh.core_vertices) == 0
    assert len(mesh.sheets()) == 1


def script(page: str, name: str) -> str:
    (text,) = re.findall(rf'<script id="{name}"[^>]*>(.*?)</script>', page, re.DOTALL)
    return text


def test_a_page_loads_nothing_from_elsewhere(tmp_path):
    path = tmp_path / "a.html"
    write_surfel_page(path, cloud(), title="</title><script>alert(1)</script> & {{scene}}")
    page = path.read_text()
    assert "default-src 'none'" in page
    assert not re.search(r"https?://|src=|@import|url\(|import\(|fetch|XMLHttpRequest|WebSocket", page)
    assert "<title>&lt;/title&gt;&lt;script&gt;alert(1)&lt;/script&gt; &amp; {{scene}}</title>" in page
    assert json.loads(script(page, "scene"))["count"] == 40


@pytest.mark.skipif(shutil.which("node") is None, reason="no node to run the page's renderer")
@pytest.mark.parametrize("degree", [0, 1, 2, 3])
def test_a_page_renders_as_the_renderer_does(tmp_path, degree):
    surfels, size = cloud(degree=degree, seed=degree), 48
    write_surfel_page(tmp_path / "a.html", surfels, title="cloud")
    page = (tmp_path / "a.html").read_text()
    (tmp_path / "scene.json").write_text(script(page, "scene"))
    camera, angles = square_camera(size), [(AZIMUTH, ELEVATION), (3.0, -0.4)]
    fx, fy, cx, cy = camera.intrinsics.tolist()
    (tmp_path / "run.js").write_text(
        script(page, "renderer")
        + f"""
const scene = unpack(JSON.parse(require("fs").readFileSync("scene.json", "utf8")));
const camera = {{ fx: {fx}, fy: {fy}, cx: {cx}, cy: {cy} }};
const images = {json.dumps(angles)}.map(([azimuth, elevation]) => Array.from(renderSurfels(
  scene, orbitPose(scene, {{ ...scene, azimuth, elevation }}), camera, {size}, {size}, "colour")));
console.log(JSON.stringify(images));
"""
    )
    run = subprocess.run(["node", "run.js"], cwd=tmp_path, capture_output=True, text=True, check=True)
    images = np.array(json.loads(run.stdout), np.uint8).reshape(2, size, size, 4)
    orbit = Orbit.around(surfels)
    for image, pose in zip(images, angles, strict=True):
        rendering = render(surfels.to(dtype=torch.float64), camera, orbit.pose(*pose), full=False, backend="torch")
        expected = to_bytes(rendering.color[0]).astype(int)
        difference = np.abs(image[..., :3] - expected)
        # One level of rounding; where alpha just reaches 1/255, up to that, on a pixel or two.
        assert difference.max() <= 2
        assert (difference > 1).mean() < 1e-3
        assert expected.std() > 10
        assert (image[..., 3] == 255).all()


# As much of a browser as the page needs. Timers run at once, frames when asked for.
BROWSER = """
const handlers = {}, frames = [], pictures = [];
const element = (more) => ({
  clientWidth: 60, clientHeight: 40, value: "colour", textContent: "",
  addEventListener: (name, handler) => { handlers[name] = handler; }, setPointerCapture: () => {},
  getContext: () => ({ putImageData: (image) => pictures.push(image), drawImage: () => {} }), ...more,
});
const text = require("fs").readFileSync("scene.json", "utf8");
const elements = { canvas: element(), caption: element(), mode: element(), scene: element({ textContent: text }) };
globalThis.document = { getElementById: (name) => elements[name], createElement: () => element() };
globalThis.window = { devicePixelRatio: 1, addEventListener: (name, handler) => { handlers[name] = handler; } };
globalThis.requestAnimationFrame = (handler) => frames.push(handler);
globalThis.setTimeout = (handler) => { handler(); return 0; };
globalThis.clearTimeout = () => {};
globalThis.ImageData = class { constructor(bytes, width, height) { Object.assign(this, { bytes, width, height }); } };
"""
GESTURES = """
const event = (more) => ({ pointerId: 1, clientX: 10, clientY: 10, buttons: 1, preventDefault: () => {}, ...more });
const shots = [];
// The picture after an action, once the object has come to rest.
const shoot = (action) => {
  action();
  frames.splice(0).forEach((frame) => frame());
  shots.push(pictures.at(-1));
};
const drag = (more) => {
  handlers.pointerdown(event()); handlers.pointermove(event({ clientX: 20, clientY: 14, ...more }));
  handlers.pointerup(event());
};
const choose = (mode) => { elements.mode.value = mode; handlers.change(); };
shoot(() => {});
shoot(() => drag());
shoot(() => drag({ shiftKey: true }));
shoot(() => handlers.wheel(event({ deltaY: 300 })));
shoot(() => handlers.keydown({ key: "ArrowLeft", preventDefault: () => {} }));
shoot(() => choose("normal"));
shoot(() => { choose("colour"); handlers.dblclick(); });
const same = (a, b) => a.bytes.every((value, i) => value === b.bytes[i]);
console.log(JSON.stringify({
  caption: elements.caption.textContent, sizes: shots.map((shot) => [shot.width, shot.height]),
  changed: shots.slice(1).map((shot, i) => !same(shot, shots[i])), back: same(shots[0], shots.at(-1)),
}));
"""


@pytest.mark.skipif(shutil.which("node") is None, reason="no node to run the page's script")
def test_a_page_answers_mouse_and_keys(tmp_path):
    write_surfel_page(tmp_path / "a.html", cloud(), title="cloud")
    page = (tmp_path / "a.html").read_text()
    (interface,) = re.findall(r"<script>(.*?)</script>", page, re.DOTALL)
    (tmp_path / "scene.json").write_text(script(page, "scene"))
    (tmp_path / "run.js").write_text(
        BROWSER + script(page, "renderer").replace('"use strict";', "") + interface + GESTURES
    )
    run = subprocess.run(["node", "run.js"], cwd=tmp_path, capture_output=True, text=True, check=True)
    seen = json.loads(run.stdout)
    assert seen["caption"] == "40 surfels"
    assert seen["sizes"] == [[60, 40]] * 7
    assert seen["changed"] == [True] * 6
    assert seen["back"]


@pytest.mark.skipif(shutil.which("node") is None, reason="no node to run the page's script")
def test_the_picture_at_rest_has_all_pixels_of_the_screen_strip_by_strip(tmp_path):
    write_surfel_page(tmp_path / "a.html", cloud(), title="cloud")
    page = (tmp_path / "a.html").read_text()
    (interface,) = re.findall(r"<script>(.*?)</script>", page, re.DOTALL)
    (tmp_path / "scene.json").write_text(script(page, "scene"))
    large = BROWSER.replace("devicePixelRatio: 1", "devicePixelRatio: 3")
    small = interface.replace("const STRIP = 2e5", "const STRIP = 4000")
    strips = """
frames.splice(0).forEach((frame) => frame());
const [coarsest, ...rest] = pictures;
// The same at once.
const whole = rows(180, 120, 0, 120).bytes, joined = rest.flatMap((one) => Array.from(one.bytes));
console.log(JSON.stringify({ sizes: rest.map((one) => [one.width, one.height]),
  same: joined.length === whole.length && joined.every((value, i) => value === whole[i]) }));
"""
    source = large + script(page, "renderer").replace('"use strict";', "") + small + strips
    (tmp_path / "run.js").write_text(source)
    run = subprocess.run(["node", "run.js"], cwd=tmp_path, capture_output=True, text=True, check=True)
    seen = json.loads(run.stdout)
    # 22 rows of 180 px in a strip; ratio 3 of 60 x 40.
    assert seen["sizes"] == [[180, 22]] * 5 + [[180, 10]]
    assert seen["same"]


def test_the_page_shows_the_same_angle_of_view_as_the_turntable():
    focal = square_camera(100).intrinsics[0].item()
    assert 2 * math.atan(50 / focal) == pytest.approx(FIELD_OF_VIEW)


def test_the_align_figure_is_drawn(tmp_path):
    iterations = np.arange(60)
    target = np.ones((48, 48, 3))
    target[10:30, 15:40] = 0.3
    strips = [Strip(f"{k}.png", target, (target + 0.1 * k).clip(0, 1), 30.0 - k) for k in range(2)]
    for loss in (np.stack((iterations, np.exp(-iterations / 20)), axis=-1), np.array([[0.0, 0.0]])):
        psnr = [("fitted", np.array([[0, 10.0], [59, 30.0]])), ("held out", np.array([[0, 9.0], [59, 28.0]]))]
        align_figure(tmp_path / "align.png", loss=loss, window=6, psnr=psnr, strips=strips, title="a fit")
        image = cv2.imread(str(tmp_path / "align.png"))
        assert image.shape == (576, 1440, 3)
        assert image.std() > 10


def test_a_white_picture_is_a_strip_too(tmp_path):
    white = np.ones((20, 30, 3))
    curve = np.array([[0, 1.0], [1, 0.5]])
    align_figure(
        tmp_path / "a.png",
        loss=curve,
        window=1,
        psnr=[("fitted", curve)],
        strips=[Strip("a", white, white, 99)],
        title="",
    )
    assert (tmp_path / "a.png").is_file()


FULL_DISK = """
import resource, sys
from pathlib import Path
import numpy as np
from pinwm_drake.errors import InputError
from pinwm_drake.report.video import write_video
resource.setrlimit(resource.RLIMIT_FSIZE, (20000, 20000))
noise = np.random.default_rng(0)
try:
    frames = (noise.integers(0, 255, (240, 240, 3), np.uint8) for _ in range(20))
    write_video(Path(sys.argv[1]), frames, rate=24, size=(240, 240))
except InputError as error:
    print(error)
"""


def test_a_video_that_does_not_fit_the_disk_is_refused_and_leaves_nothing(tmp_path):
    command = [sys.executable, "-c", FULL_DISK, str(tmp_path / "a.mp4")]
    run = subprocess.run(command, cwd=ROOT, capture_output=True, text=True, check=True)
    assert "a.mp4: got a film that could not be written to its end; allowed: a disk with enough space" in run.stdout
    assert list(tmp_path.iterdir()) == []


def test_a_page_that_cannot_be_written_is_refused(tmp_path):
    with pytest.raises(InputError, match=r"a\.html: no such file"):
        write_surfel_page(tmp_path / "missing/a.html", cloud(), title="cloud")
