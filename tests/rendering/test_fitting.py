# SPDX-License-Identifier: MIT
import json
import os
import signal
import subprocess
import sys
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import torch

from pinwm_drake.checkpoints import load_arrays, write_arrays
from pinwm_drake.errors import InputError, ParameterError, RenderingError
from pinwm_drake.rendering.camera import Camera
from pinwm_drake.rendering.densify import densify
from pinwm_drake.rendering.fit_options import FitOptions
from pinwm_drake.rendering.fit_state import SURFEL, FitState
from pinwm_drake.rendering.fitting import finer_by, fit, pooled, psnr
from pinwm_drake.rendering.render import render
from pinwm_drake.rendering.surfels import Surfels
from pinwm_drake.rendering.views import View
from tests.rendering.boxes import box, views_around

ROOT = Path(__file__).resolve().parents[2]

# A fit of 40 iterations that does everything there is: coarse images, degrees 0 to 2, densification, and outlines.
SMALL = FitOptions(
    iterations=40,
    max_surfels=130,
    first_surfels=100,
    sh_degree=2,
    sh_every=12,
    held_out=3,
    geometry_every=3,
    coarse=0.2,
    margin=4,
    densify_from=0.1,
    densify_until=0.8,
    densify_every=8,
    evaluate_every=16,
    checkpoint_every=15,
    seed=3,
    num_threads=1,
)


@pytest.fixture(scope="module")
def mesh():
    return box()


@pytest.fixture(scope="module")
def views(mesh):
    return views_around(mesh)


@pytest.fixture(scope="module")
def result(mesh, views):
    return fit(views, mesh, SMALL)


def assert_same(one, two):
    for name, tensor in one.surfels.tensors().items():
        assert torch.equal(tensor, two.surfels.tensors()[name]), name
    for name in ("iteration", "loss", "psnr", "num_surfels", "test_iteration", "test_psnr"):
        assert np.array_equal(getattr(one.history, name), getattr(two.history, name)), name
    assert (one.psnr_train, one.psnr_test) == (two.psnr_train, two.psnr_test)
    assert one.camera_offset == two.camera_offset


def test_a_fit_comes_closer(mesh, views):
    history = fit(views, mesh, replace(SMALL, iterations=200)).history
    # From the first whole images on, 0.73 was measured; PSNR 16.8 to 21.3 dB.
    assert np.mean(history.loss[-8:]) < 0.85 * np.mean(history.loss[40:48])
    assert np.mean(history.psnr[-8:]) > np.mean(history.psnr[:8]) + 3.0


def test_a_fit_says_how_close_it_is(mesh, views, result):
    result.surfels.check()
    assert result.surfels.degree == 2
    assert 100 < result.surfels.num_surfels <= 130
    assert list(result.psnr_train) == ["view 0", "view 1", "view 3", "view 4"]
    assert list(result.psnr_test) == ["view 2", "view 5"]
    # What is returned is what was measured.
    view = views[5]
    offset = torch.tensor([0.0, 0.0, *result.camera_offset])
    camera = Camera(view.camera.width, view.camera.height, view.camera.intrinsics + offset)
    color = render(result.surfels, camera, view.X_CO, full=False, num_threads=1).color[0]
    measured = psnr(float((color - view.image).square().mean(dtype=torch.float64)))
    # The quaternions come back with unit length, which costs their last digits.
    assert measured == pytest.approx(result.psnr_test["view 5"], abs=1e-3)
    assert result.history.test_psnr[-1] == pytest.approx(np.mean(list(result.psnr_test.values())))


def test_history_and_progress_agree(mesh, views):
    calls = []
    result = fit(views, mesh, SMALL, progress=lambda *call: calls.append(call))
    assert [call[:2] for call in calls] == [(i, 40) for i in range(1, 41)]
    assert [call[2] for call in calls] == result.history.loss.tolist()
    assert [call[4] for call in calls] == result.history.num_surfels.tolist()
    assert result.history.test_iteration.tolist() == [16, 32, 40]
    assert [call[3] for call in calls[:15]] == [None] * 15
    assert calls[16][3] == result.history.test_psnr[0]
    assert result.seconds > 0.0


def test_the_same_seed_gives_the_same_bits(mesh, views, result):
    assert_same(fit(views, mesh, SMALL), result)
    other = fit(views, mesh, replace(SMALL, seed=4))
    assert not torch.equal(other.surfels.p_OS[:50], result.surfels.p_OS[:50])


def test_two_threads_repeat_themselves(mesh, views):
    options = replace(SMALL, iterations=10, num_threads=2)
    assert_same(fit(views, mesh, options), fit(views, mesh, options))


def test_the_reference_fits_alike(mesh, views):
    options = replace(SMALL, iterations=6, densify_until=0.0, first_surfels=40)
    fast, slow = fit(views, mesh, options), fit(views, mesh, replace(options, backend="torch"))
    # Rounding grows by Adam, which divides by the size of the gradients: the losses stay near, not equal.
    assert fast.history.loss == pytest.approx(slow.history.loss, rel=0.02)


class Stop(Exception):
    pass


@pytest.mark.parametrize("last", [1, 15, 16, 30, 39])
def test_an_interrupted_fit_goes_on_to_the_same_bits(mesh, views, result, tmp_path, last):
    def stop(iteration, *_):
        if iteration == last:
            raise Stop

    with pytest.raises(Stop):
        fit(views, mesh, SMALL, folder=tmp_path, progress=stop)
    first = []
    resumed = fit(views, mesh, SMALL, folder=tmp_path, resume=True, progress=lambda i, *_: first.append(i))
    # The checkpoint of an iteration is written after its call of `progress`.
    assert first[0] == 1 + 15 * ((last - 1) // 15)
    assert_same(resumed, result)


SCRIPT = """
import sys
from pathlib import Path
from pinwm_drake.rendering.fitting import fit
from tests.rendering.boxes import box, views_around
from tests.rendering.test_fitting import SMALL

def tell(iteration, *_):
    print(iteration, flush=True)

mesh = box()
fit(views_around(mesh), mesh, SMALL, folder=Path(sys.argv[1]), progress=tell)
"""


@pytest.mark.nightly
def test_a_killed_fit_goes_on_to_the_same_bits(mesh, views, result, tmp_path):
    environment = {**os.environ, "PYTHONPATH": str(ROOT)}
    command = [sys.executable, "-c", SCRIPT, str(tmp_path)]
    with subprocess.Popen(command, stdout=subprocess.PIPE, text=True, cwd=ROOT, env=environment) as process:
        for line in process.stdout:
            if int(line) == 22:
                process.send_signal(signal.SIGKILL)
                break
    assert process.returncode == -signal.SIGKILL
    assert [path.name for path in tmp_path.iterdir()] == ["checkpoint.npz"]
    first = []
    resumed = fit(views, mesh, SMALL, folder=tmp_path, resume=True, progress=lambda i, *_: first.append(i))
    assert first[0] == 16
    assert_same(resumed, result)


def test_a_finished_fit_is_not_done_again(mesh, views, result, tmp_path):
    fit(views, mesh, SMALL, folder=tmp_path)
    calls = []
    again = fit(views, mesh, SMALL, folder=tmp_path, resume=True, progress=lambda *call: calls.append(call))
    assert calls == []
    assert_same(again, result)
    assert again.seconds > 0.0


def test_without_a_checkpoint_resume_starts(mesh, views, tmp_path):
    options = replace(SMALL, iterations=3)
    assert_same(fit(views, mesh, options, folder=tmp_path, resume=True), fit(views, mesh, options))


def test_a_checkpoint_of_another_fit_is_refused(mesh, views, tmp_path):
    options = replace(SMALL, iterations=3)
    fit(views, mesh, options, folder=tmp_path)
    other = replace(options, dssim=0.3)
    with pytest.raises(
        InputError, match=r"checkpoint\.npz: got a fit with dssim = 0\.2; allowed: one with dssim = 0\.3"
    ):
        fit(views, mesh, other, folder=tmp_path, resume=True)
    with pytest.raises(InputError, match="views and mesh"):
        fit(views[::-1], mesh, options, folder=tmp_path, resume=True)
    fit(views, mesh, replace(options, checkpoint_every=7), folder=tmp_path, resume=True)


@pytest.mark.parametrize("kept", [0, 10, 3000, -1])
def test_a_broken_checkpoint_is_named(mesh, views, tmp_path, kept):
    options = replace(SMALL, iterations=2)
    fit(views, mesh, options, folder=tmp_path)
    path = tmp_path / "checkpoint.npz"
    path.write_bytes(path.read_bytes()[:kept])
    with pytest.raises(InputError, match=r"checkpoint\.npz: got unreadable contents"):
        fit(views, mesh, options, folder=tmp_path, resume=True)


def test_a_checkpoint_without_its_arrays_is_named(mesh, views, tmp_path):
    options = replace(SMALL, iterations=2)
    fit(views, mesh, options, folder=tmp_path)
    path = tmp_path / "checkpoint.npz"
    with np.load(path) as file:
        about = file["about"]
    np.savez(path, about=about)
    with pytest.raises(InputError, match=r"checkpoint\.npz: got arrays with SHA-256 .*, as written"):
        fit(views, mesh, options, folder=tmp_path, resume=True)
    np.savez(path, about=np.array(json.dumps([1])))
    with pytest.raises(InputError, match=r"checkpoint\.npz: got about = \[1\]"):
        fit(views, mesh, options, folder=tmp_path, resume=True)


def test_a_full_disk_keeps_the_earlier_checkpoint(mesh, views, tmp_path, monkeypatch):
    options = replace(SMALL, iterations=4, checkpoint_every=2)

    def full(file, **_):
        Path(file).write_bytes(b"PK")
        raise OSError(28, "No space left on device")

    def fill(iteration, *_):
        if iteration == 3:
            monkeypatch.setattr(np, "savez", full)

    with pytest.raises(InputError, match=r"checkpoint\.npz: no space left on device"):
        fit(views, mesh, options, folder=tmp_path, progress=fill)
    monkeypatch.undo()
    first = []
    fit(views, mesh, options, folder=tmp_path, resume=True, progress=lambda i, *_: first.append(i))
    assert first == [3, 4]


def test_what_does_not_fit_is_named(mesh, views, tmp_path):
    with pytest.raises(RenderingError, match="0 views, of which 0 are held out"):
        fit([], mesh, SMALL)
    with pytest.raises(RenderingError, match="resume needs the folder"):
        fit(views, mesh, SMALL, resume=True)
    with pytest.raises(InputError, match="no such folder"):
        fit(views, mesh, SMALL, folder=tmp_path / "none")


def test_torch_keeps_its_threads(mesh, views):
    before = torch.get_num_threads()
    fit(views, mesh, replace(SMALL, iterations=1))
    assert torch.get_num_threads() == before


def test_the_principal_point_is_learnt(mesh, views):
    # The images are moved by (0.5, -0.5) px against what their cameras say.
    offset = torch.tensor([0.0, 0.0, 0.5, -0.5])
    moved = [
        View(v.name, Camera(48, 48, v.camera.intrinsics - offset), v.X_CO, v.image, v.mask)
        for v in views_around(mesh, 8, 48)
    ]
    options = replace(
        SMALL, iterations=160, held_out=0, densify_until=0.0, coarse=0.0, rate_camera=0.05, first_surfels=None
    )
    found = fit(moved, mesh, options).camera_offset
    # Twelve pixels wide faces, 48 x 48 px: a tenth or two of a pixel is what they tell.
    assert found == pytest.approx((0.5, -0.5), abs=0.25)
    assert fit(views[:2], mesh, replace(options, iterations=2, rate_camera=0.0)).camera_offset == (0.0, 0.0)


@pytest.mark.parametrize(
    ("values", "message"),
    [
        ({"iterations": 0}, r"--iterations: got 0; allowed: 1 to 10000000"),
        ({"iterations": 2.5}, r"--iterations: got 2\.5; allowed: 1 to 10000000"),
        ({"sh_degree": 4}, r"--sh-degree: got 4; allowed: 0 to 3"),
        ({"dssim": 1.5}, r"dssim: got 1\.5; allowed: 0 to 1"),
        ({"dssim": float("nan")}, r"dssim: got nan; allowed: 0 to 1"),
        ({"rate_position": -1e-3}, r"rate_position: got -0\.001; allowed"),
        ({"photometric": "l3"}, r"photometric: got 'l3'; allowed: l1, l2"),
        ({"backend": "cuda"}, r"backend: got 'cuda'; allowed: numba, torch"),
        ({"held_out": 1}, r"--held-out: got 1, which leaves no view to fit"),
        ({"first_surfels": 6000}, r"first_surfels: got 6000; allowed: 1 to max_surfels = 5000"),
        ({"num_threads": 0}, r"--threads: got 0; allowed: 1 to 1024"),
        ({"seed": True}, r"--seed: got True; allowed: 0 to 2147483647"),
        ({"normal": "high"}, r"normal: got 'high'; allowed: 0 to"),
    ],
)
def test_options_name_what_is_out_of_range(values, message):
    with pytest.raises(ParameterError, match=message):
        FitOptions(**values)


def test_options_tell_stages():
    options = FitOptions(iterations=1001, sh_degree=2, sh_every=300, final_rate=0.01)
    assert [options.degree(i) for i in (0, 299, 300, 600, 1000)] == [0, 0, 1, 2, 2]
    assert options.rate(0) == 1.0
    assert options.rate(500) == pytest.approx(0.1)
    assert options.rate(1000) == pytest.approx(0.01)


def state_of(opacities, scales, options):
    N = len(opacities)
    surfels = Surfels(
        torch.arange(3.0 * N).reshape(N, 3),
        torch.tensor([[1.0, 0.0, 0.0, 0.0]] * N),
        torch.tensor(scales).log(),
        torch.tensor(opacities).logit(),
        torch.zeros(N, 4, 3),
    )
    return FitState(surfels, options, 1.0)


def test_densification_splits_the_large_and_clones_the_small():
    options = FitOptions(max_surfels=10, growth=1.0, least_opacity=0.02)
    # Large along x, small, transparent, never moved.
    state = state_of([0.9, 0.8, 0.01, 0.5], [[4.0, 1.0], [1.0, 1.0], [1.0, 1.0], [1.0, 1.0]], options)
    state.watch(torch.tensor([[3.0, 4.0], [1.0, 0.0], [9.0, 0.0], [0.0, 0.0]]))
    assert densify(state, options, pixel=1.0) == (2, 1)
    tensors = {name: state.tensors[name].detach() for name in SURFEL}
    assert state.num_surfels == 5
    # The one that stays comes first, then one half of each, then the other.
    p, opacity, scale = tensors["p_OS"], tensors["logit_opacity"].sigmoid(), tensors["log_scale"].exp()
    assert torch.equal(p[0], torch.tensor([9.0, 10.0, 11.0]))
    assert torch.allclose(p[1] + p[3], 2.0 * torch.tensor([0.0, 1.0, 2.0]))
    assert torch.allclose(p[1] - p[3], torch.tensor([2 * 0.7 * 4.0, 0.0, 0.0]), atol=1e-5)
    assert torch.allclose(scale[1], torch.tensor([2.4, 1.0]))
    assert opacity[1].item() == pytest.approx(0.9)
    # Two clones let through as much as their parent: (1 - o)^2 = 1 - 0.8.
    assert torch.equal(p[2], p[4])
    assert (1.0 - opacity[2].item()) ** 2 == pytest.approx(0.2, rel=1e-5)
    assert bool((state.screen == 0.0).all())


def test_densification_keeps_to_its_limit():
    options = FitOptions(max_surfels=6, growth=1.0)
    state = state_of([0.5] * 5, [[1.0, 1.0]] * 5, options)
    state.watch(torch.eye(5)[:, :2] + 0.1)
    assert densify(state, options, pixel=1.0) == (1, 0)
    assert state.num_surfels == 6
    state.watch(torch.ones(6, 2))
    assert densify(state, options, pixel=1.0) == (0, 0)


def test_moments_stay_with_their_surfels():
    options = FitOptions(max_surfels=4, growth=1.0)
    state = state_of([0.5] * 3, [[1.0, 1.0]] * 3, options)
    for _ in range(3):
        (state.surfels(1).p_OS * torch.tensor([[1.0], [2.0], [3.0]])).sum().backward()
        state.step(1.0)
    moments = state.first["p_OS"].clone()
    assert bool((moments > 0.0).all())
    state.watch(torch.tensor([[0.0, 0.0], [1.0, 0.0], [0.0, 0.0]]))
    densify(state, options, pixel=10.0)
    # Surfel 1 became two, without moments.
    assert torch.equal(state.first["p_OS"], torch.cat([moments[[0, 2]], torch.zeros(2, 3)]))
    p = state.tensors["p_OS"].detach().clone()
    state.surfels(1).p_OS.sum().backward()
    state.step(1.0)
    assert bool((state.tensors["p_OS"] < p).all())


def test_views_are_checked_and_cut(views):
    view = views[0]
    with pytest.raises(RenderingError, match=r"view view 0: image is \(48, 47, 3\); allowed: \(48, 48, 3\)"):
        replace(view, image=view.image[:, 1:])
    with pytest.raises(RenderingError, match="values outside 0 to 1"):
        replace(view, image=view.image * 2.0)
    with pytest.raises(RenderingError, match=r"torch\.float64 and torch\.bool"):
        replace(view, image=view.image.double())
    with pytest.raises(RenderingError, match="X_CO is not finite"):
        replace(view, X_CO=view.X_CO._replace(p=view.X_CO.p * torch.nan))
    corners = torch.from_numpy(box().vertices.copy())
    x, y, width, height = view.object_box(corners, 2)
    rows, columns = torch.nonzero(view.mask, as_tuple=True)
    assert x <= columns.min() - 2
    assert y + height >= rows.max() + 3
    part = view.cropped(x, y, width, height)
    assert int(part.mask.sum()) == int(view.mask.sum())
    assert torch.equal(part.project(corners)[0] + torch.tensor([x, y]), view.project(corners)[0])
    half = view.scaled(0.5)
    assert torch.allclose(half.image[3, 4], view.image[6:8, 8:10].mean((0, 1)), atol=1e-6)
    assert torch.allclose(half.project(corners)[0], 0.5 * view.project(corners)[0])


def test_a_box_around_a_point_behind_the_camera_is_the_whole_image(views):
    behind = torch.tensor([[0.0, 0.0, 0.0], [9.0, 3.0, 9.0]], dtype=torch.float64)
    assert views[0].object_box(behind, 0) == (0, 0, 48, 48)


def test_small_images_are_rendered_finer_and_averaged(mesh):
    views = views_around(mesh, 3)
    assert set(finer_by(views).values()) == {1}
    views[1] = views[1].scaled(0.5)
    assert list(finer_by(views).values()) == [1, 2, 1]
    color = torch.arange(4 * 6 * 3, dtype=torch.float32).reshape(4, 6, 3)
    assert torch.equal(pooled(color, 1), color)
    torch.testing.assert_close(pooled(color, 2)[1, 2], color[2:4, 4:6].mean((0, 1)))


def test_the_psnr_of_a_small_view_is_that_of_means_of_pixels(mesh):
    views = views_around(mesh, 3)
    views[1] = small = views[1].scaled(0.5)
    with pytest.warns(UserWarning, match="1 of 3 images are small, which costs quality"):
        found = fit(views, mesh, replace(SMALL, iterations=6, held_out=0))
    camera = small.camera.shifted(found.camera_offset).scaled(2)
    with torch.no_grad():
        color = render(found.surfels, camera, small.X_CO, full=False).color[0]
    rows = torch.nn.functional.avg_pool2d(color.permute(2, 0, 1)[None], 2)[0].permute(1, 2, 0)
    square = float((rows - small.image).square().mean(dtype=torch.float64))
    assert found.psnr_train[small.name] == pytest.approx(psnr(square), abs=1e-4)


@pytest.mark.parametrize(
    ("change", "words"),
    [
        (lambda arrays: cut(arrays, 3), "3 surfels, where its last row has"),
        (lambda arrays: arrays | {"tensor.p_OS": arrays["tensor.p_OS"][:, :2]}, "tensor.p_OS of float32"),
        (lambda arrays: arrays | {"first.log_scale": arrays["first.log_scale"] * np.nan}, "not finite"),
        (lambda arrays: arrays | {"iteration": np.array(41)}, "iteration 41 with 15 rows"),
        (lambda arrays: arrays | {"iteration": np.array(14)}, "iteration 14 with 15 rows"),
        (lambda arrays: arrays | {"rows": arrays["rows"][:-1]}, "with 14 rows"),
        (lambda arrays: arrays | {"second.camera": -arrays["second.camera"] - 1.0}, "surfels"),
    ],
)
def test_a_checkpoint_whose_contents_do_not_fit_is_refused(mesh, views, tmp_path, change, words):

    def stop(iteration, *_):
        if iteration == 16:
            raise Stop

    with pytest.raises(Stop):
        fit(views, mesh, SMALL, folder=tmp_path, progress=stop)
    arrays, about = load_arrays(tmp_path / "checkpoint.npz", "a checkpoint")
    write_arrays(tmp_path / "checkpoint.npz", about, change(arrays))
    with pytest.raises(InputError, match=words):
        fit(views, mesh, SMALL, folder=tmp_path, resume=True)


def cut(arrays, number):
    """The arrays of the first surfels alone."""
    count = len(arrays["tensor.p_OS"])
    return {name: one[:number] if one.shape[:1] == (count,) else one for name, one in arrays.items()}
