# SPDX-License-Identifier: MIT
import shutil
from dataclasses import replace

import numpy as np
import pytest
import torch

from pinwm_drake.capture.episodes import read_episode, read_episode_image
from pinwm_drake.capture.pusher import pusher_surface
from pinwm_drake.capture.scene import load_capture
from pinwm_drake.errors import InputError, ParameterError
from pinwm_drake.identification.checkpoint import CHECKPOINT_FILE
from pinwm_drake.identification.expansion import corrected, expand
from pinwm_drake.identification.forward import Forward, inertia
from pinwm_drake.identification.identify import identify_theta
from pinwm_drake.identification.image_loss import BLOCKS, rendered
from pinwm_drake.identification.lighting import brightened, lit
from pinwm_drake.identification.options import IdentifyOptions
from pinwm_drake.identification.pictures import make_pictures, read_footage
from pinwm_drake.identification.problem import FilmedEpisode, Problem
from pinwm_drake.identification.unknowns import DEFAULT_FREE, Coordinates
from pinwm_drake.report.twin.score import pose_errors
from pinwm_drake.scene import make_scene
from pinwm_drake.spatial.poses import Pose
from pinwm_drake.twin.origin import identified_push
from tests.identification.samples import LEVEL, TRUTH, surfels, true_force, write_capture, write_episode

QUICK = {
    "screened": 12,
    "starts": 2,
    "coarse_iterations": 15,
    "fine_iterations": 6,
    "moves": 12,
    "coarse_size": 20.0,
    "fine_size": 40.0,
    "num_threads": 2,
    "checkpoint_every": 3,
}


@pytest.fixture(scope="module")
def pushed(tmp_path_factory):
    folder = write_capture(tmp_path_factory.mktemp("identify") / "capture")
    capture = load_capture(folder)
    return capture, read_episode(capture, "0000")


def footage_of(pushed):
    capture, episode = pushed
    return read_footage(episode, pusher_surface(capture.pusher), (0.0, 0.0))


def pictures_of(pushed, size=40.0, together=False):
    return make_pictures(footage_of(pushed), size, together=together)


def problem_of(pushed, free=DEFAULT_FREE, held=None, **options):
    capture, episode = pushed
    scene = make_scene(capture.object.mesh_path, capture.pusher, q_WO=LEVEL, gravity=9.81, support="patch")
    forward = Forward(scene, episode, capture.object.X_WO, 1.0, 2)
    push = FilmedEpisode(forward, pictures_of(pushed, **options), surfels())
    return Problem((push,), Coordinates(free, TRUTH if held is None else held), 2)


def test_the_truth_explains_the_video(pushed):
    problem = problem_of(pushed)
    z = torch.zeros(2, len(problem.coordinates), dtype=torch.float64)
    z[1, problem.coordinates.names.index("friction_floor")] = 1.5
    losses = problem.frame_losses(z, (1,))[0].mean(0)
    # What is left is alpha, which is all or nothing in the images, and the pixels that are halved.
    assert float(losses[0]) < 0.01
    assert float(losses[1]) > 1.5 * float(losses[0])


def test_poses_at_the_truth_are_the_truth(pushed):
    even = {f"support_{axis}": 1.0 for axis in "xyz"}
    problem = problem_of(pushed, held=TRUTH | even)
    z = torch.zeros(1, len(DEFAULT_FREE)).double()
    X_WO, alive = problem.pushes[0].forward.poses(problem.coordinates.values(z))
    assert bool(alive.all())
    assert np.allclose(X_WO.p[:, 0], pushed[1].object_poses.p_WO, atol=1e-5)


def test_gradient_of_the_loss_is_that_of_differences(pushed):
    problem = problem_of(pushed, together=True)
    names = problem.coordinates.names
    z = 0.3 * torch.randn(5, len(names), generator=torch.Generator().manual_seed(1), dtype=torch.float64)
    z[:, names.index("outline")] = 0.0
    moving = z.clone().requires_grad_()
    problem.frame_losses(moving, BLOCKS)[0].mean(0).sum().backward()
    # Steps that are large against the noise of float32 images and small against the kinks of contact: a shift in time
    # decides in which step the pusher leaves. A guess that has a kink within its step tells nothing, so that the second
    # best of five is compared.
    moved = ("friction_floor", "start_x", "start_y", "start_yaw", "lift", "time_offset", "support_x", "contact_offset")
    for name in (*moved, "grip_floor", "frame_x", "frame_y", "frame_yaw"):
        column = names.index(name)
        change, step = torch.zeros_like(z), 0.003 if name == "time_offset" else 0.03
        change[:, column] = step
        with torch.no_grad():
            up, down = (problem.frame_losses(one, BLOCKS)[0].mean(0) for one in (z + change, z - change))
        difference = (up - down) / (2 * step)
        error = (moving.grad[:, column] - difference).abs() / (0.05 * difference.abs() + 1e-5)
        assert float(error.quantile(0.25)) < 1.0, name


def test_quadratic_model_predicts_the_loss(pushed):
    episode = pushed[1]
    pictures, truth = pictures_of(pushed), episode.object_poses
    X_WO = Pose(torch.from_numpy(truth.q_WO), torch.from_numpy(truth.p_WO))
    one = torch.ones((), dtype=torch.float64)
    model = expand(pictures, surfels(), X_WO, one, 0.05)
    d = torch.tensor([0.01, -0.005, 0.01, 4e-4, -3e-4, 2e-4], dtype=torch.float64).expand(len(truth.t), 6)
    after = expand(pictures, surfels(), corrected(X_WO, d), one, 0.05).loss
    d = torch.nn.functional.pad(d, (0, 1))
    rise = 2.0 * (model.gradient * d).sum(-1) + (d[:, None] @ model.curvature @ d[..., None])[:, 0, 0]
    assert float(rise.sum()) == pytest.approx(float((after - model.loss).sum()), rel=0.3)


def test_inertia_is_that_of_a_body_for_any_moments(pushed):
    scene = problem_of(pushed).pushes[0].forward.scene
    values = {name: torch.tensor([0.05, 20.0, 1.0]).double() for name in ("moment_xx", "moment_yy")}
    values["moment_zz"] = torch.tensor([20.0, 0.05, 1.0]).double()
    moments = torch.linalg.eigvalsh(inertia(scene, 2.0, values))
    assert (moments[:, 0] > 0).all()
    assert (moments[:, 0] + moments[:, 1] >= moments[:, 2] * (1 - 1e-12)).all()
    assert np.allclose(inertia(scene, 2.0, values)[2], 2.0 * np.asarray(scene.model.bodies[0].inertia))


def test_the_pusher_hides_pixels_that_do_not_count(pushed):
    problem = problem_of(pushed, together=True)
    pictures = problem.pushes[0].pictures
    hidden = pictures.weight == 0
    assert 0.001 < float(hidden.float().mean()) < 0.3
    # Where the pusher is, opacity is no evidence: changing it there changes nothing.
    z = torch.zeros(1, len(problem.coordinates), dtype=torch.float64)
    before = problem.frame_losses(z, (1,))[0]
    pictures.alpha[hidden] = 0.37
    assert torch.equal(problem.frame_losses(z, (1,))[0], before)


def test_hidden_pixels_follow_the_clock(pushed):
    footage = footage_of(pushed)
    early, late = (make_pictures(footage, 40.0, together=True, late=late).weight == 0 for late in (0.0, 0.06))
    middle = len(early) // 3
    columns = torch.arange(early.shape[2]).float()
    first, second = ((hidden[middle].float().sum(0) * columns).sum() / hidden[middle].sum() for hidden in (early, late))
    # The pusher goes 18 mm along x in 0.06 s, to the right of the image.
    assert float(second - first) > 1.0


def test_friction_is_found_from_images_alone(pushed):
    capture, episode = pushed
    found = identify_theta(capture, episode, surfels(), (0.0, 0.0), IdentifyOptions(**QUICK))
    theta, nuisance = found.twin.theta, found.twin.nuisance
    # The object coasts for 23 mm, which a pixel of 3 mm and 12 frames show to a few per cent.
    assert theta["friction_floor"].value == pytest.approx(TRUTH["friction_floor"], rel=0.05)
    low, high = theta["friction_floor"].interval
    assert low < theta["friction_floor"].value < high
    assert theta["friction_floor"].identifiable
    assert not theta["mass"].identifiable
    assert abs(nuisance["time_offset"].value) < 4e-3
    assert abs(nuisance["lift"].value) < 1.5e-3
    errors = pose_errors(found.poses[0], episode.object_poses)
    assert errors.position.mean() < 1.5e-3
    # Uniform pressure: the spread is one.
    low, high = nuisance["support_x"].interval
    assert low < 1.0 < high
    draws = found.twin.draws
    assert draws.values.shape == (400, len(draws.names))
    assert np.quantile(draws.column("friction_floor"), 0.5) == pytest.approx(TRUTH["friction_floor"], rel=0.1)


@pytest.mark.nightly
def test_interrupted_search_comes_to_the_same_result(pushed, tmp_path):
    capture, episode = pushed
    options = IdentifyOptions(**{**QUICK, "support": "patch", "coarse_iterations": 7, "fine_iterations": 2, "moves": 4})
    whole = identify_theta(capture, episode, surfels(), (0.0, 0.0), options)

    class Stop(Exception):
        pass

    for steps in (5, 6, 7):
        calls = []

        def report(step, calls=calls, steps=steps):
            calls.append(step)
            if len(calls) == steps:
                raise Stop

        with pytest.raises(Stop):
            identify_theta(
                capture, episode, surfels(), (0.0, 0.0), options, folder=tmp_path, resume=True, report=report
            )
    again = identify_theta(capture, episode, surfels(), (0.0, 0.0), options, folder=tmp_path, resume=True)
    assert again.twin.theta == whole.twin.theta
    assert again.twin.nuisance == whole.twin.nuisance
    assert np.array_equal(again.poses[0].p_WO, whole.poses[0].p_WO)
    assert again.found.log.arrays()["loss"].tolist() == whole.found.log.arrays()["loss"].tolist()
    # A search with other options does not go on from it.
    with pytest.raises(InputError, match="seed = 0"):
        identify_theta(
            capture,
            episode,
            surfels(),
            (0.0, 0.0),
            IdentifyOptions(**{**QUICK, "support": "patch", "seed": 1}),
            folder=tmp_path,
            resume=True,
        )
    (tmp_path / CHECKPOINT_FILE).write_bytes(b"half a file")
    with pytest.raises(InputError, match="unreadable contents"):
        identify_theta(capture, episode, surfels(), (0.0, 0.0), options, folder=tmp_path, resume=True)


def test_what_the_video_does_not_show_is_not_identifiable(pushed):
    # With mass and inertia free, only their ratio moves the object: the mass keeps its prior.
    capture, episode = pushed
    free = ("mass", "moment_xx", "moment_yy", "friction_floor", "friction_pusher", "outline")
    held = {"friction_floor": 0.2, "friction_pusher": 0.3}
    options = {"support": "patch", "free": free, "held": held, "coarse_iterations": 3, "screened": 1, "starts": 1}
    brief = {"fine_iterations": 3, "moves": 8}
    found = identify_theta(capture, episode, surfels(), (0.0, 0.0), IdentifyOptions(**{**QUICK, **options, **brief}))
    mass = found.twin.theta["mass"]
    assert not mass.identifiable
    assert mass.interval[1] / mass.interval[0] > 4.0


def test_a_frame_without_the_object_is_looked_at_where_it_was_last_seen(pushed):
    footage = footage_of(pushed)
    empty = np.zeros((0, 0, 4), np.uint8)
    gone = [0, 2, 3]  # not those that show it largest, which set the scale
    frames = [replace(frame, pixels=empty) if k in gone else frame for k, frame in enumerate(footage.frames)]
    found, whole = make_pictures(replace(footage, frames=frames), 40.0, together=False), pictures_of(pushed)
    for k, seen in ((0, 1), (2, 1), (3, 1), (7, 7)):
        assert torch.equal(found.camera.intrinsics[k], whole.camera.intrinsics[seen])
    assert not torch.equal(whole.camera.intrinsics[1], whole.camera.intrinsics[3])
    assert float(found.alpha[2].max()) == 0.0


def test_pictures_are_averages_over_their_pixels(pushed):
    # At a third of the size every pixel is the mean of nine.
    footage = footage_of(pushed)
    pictures = make_pictures(footage, footage.longest / 3, together=False)
    camera = pushed[1].camera.intrinsics
    image, mask = read_episode_image(pushed[1].folder, pushed[1].file_names[4], pushed[1].camera)
    x, y = (3 * (camera[2:] / 3 - pictures.camera.intrinsics[4, 2:])).round().int().tolist()
    height, width = pictures.alpha.shape[1:]
    rows, columns = slice(max(y, 0), y + 3 * height), slice(max(x, 0), x + 3 * width)
    assert min(x, y) >= 0
    mean = mask[rows, columns].reshape(height, 3, width, 3).mean((1, 3))
    assert np.allclose(pictures.alpha[4], mean, atol=1e-6)
    color = np.where(mask[..., None], image, 1.0)[rows, columns].reshape(height, 3, width, 3, 3).mean((1, 3))
    assert np.allclose(pictures.color[4], color, atol=3e-3)


def test_some_of_the_pictures_are_those_frames(pushed):
    pictures, chosen = pictures_of(pushed), torch.tensor([0, 7])
    found = pictures.some(chosen)
    assert torch.equal(found.X_CW.p, pictures.X_CW.p[chosen])
    for name in ("color", "alpha", "weight", "middle"):
        assert torch.equal(getattr(found, name), getattr(pictures, name)[chosen])
    assert torch.equal(found.camera.intrinsics, pictures.camera.intrinsics[chosen])


@pytest.fixture(scope="module")
def pushed_twice(tmp_path_factory):
    """Two pushes at other sides, the second of which two cameras see."""
    folder = write_capture(tmp_path_factory.mktemp("twice") / "capture")
    second = folder / "episodes/0001"
    write_episode(folder, second, offset=-0.01)
    (second / "cameras/again").mkdir(parents=True)
    for name in ("camera.json", "frames.csv"):
        shutil.copyfile(second / name, second / "cameras/again" / name)
    shutil.copytree(second / "rgb", second / "cameras/again/rgb")
    capture = load_capture(folder)
    return capture, [read_episode(capture, name) for name in ("0000", "0001")]


@pytest.mark.nightly
def test_pushes_and_cameras_are_explained_together(pushed_twice):
    capture, episodes = pushed_twice
    assert [view.name for view in episodes[1].views] == ["", "again"]
    felt = replace(episodes[1].trajectory, force_W=1.7 * true_force(capture.object.mesh_path, offset=-0.01))
    episodes = [episodes[0], replace(episodes[1], trajectory=felt)]
    found = identify_theta(capture, episodes, surfels(), (0.0, 0.0), IdentifyOptions(**QUICK))
    theta, nuisance = found.twin.theta, found.twin.nuisance
    assert theta["friction_floor"].value == pytest.approx(TRUTH["friction_floor"], rel=0.05)
    assert {"start_x.0", "start_x.1", "support_x", "lift"} <= set(nuisance)
    for episode, poses in zip(episodes, found.poses, strict=True):
        assert len(poses.t) == len(episode.t)
        assert pose_errors(poses, episode.object_poses).position.mean() < 1.5e-3
    # The force on the pusher, of one of them, tells the mass, as well as the images tell the floor's friction.
    mass, ratio = theta["mass"], theta["inertia_zz"].value / theta["mass"].value
    assert mass.value == pytest.approx(1.7, rel=0.05)
    assert mass.identifiable
    assert mass.interval[0] < 1.7 < mass.interval[1]
    assert ratio == pytest.approx(0.06**2 / 6, rel=0.3)
    assert found.twin.draws.column("mass").mean() == pytest.approx(mass.value, rel=0.1)
    assert "mass from the force on the pusher" in found.twin.provenance["force"]["note"]
    counts = [push.num_frames for push in found.found.problem.pushes]
    assert counts == [12, 24]
    assert found.twin.provenance["episodes"] == ["0000", "0001"]
    assert identified_push(found.twin, capture, episodes[1]) == 1
    with pytest.raises(ParameterError, match="each once"):
        identify_theta(capture, [episodes[0], episodes[0]], surfels(), (0.0, 0.0))


def test_light_of_the_video_is_found(pushed):
    # All faces darker, and the top one more: the gains bring the rendering back to the picture.
    problem = problem_of(pushed, together=True)
    pictures, truth = problem.pushes[0].pictures, pushed[1].object_poses
    X_WO = Pose(torch.from_numpy(truth.q_WO), torch.from_numpy(truth.p_WO))
    first = surfels()
    up = (first.p_OS[:, 2] > 0.49 * 0.06).float()[:, None]
    dark = brightened(first, 0.8 - 0.3 * up)
    one = torch.ones(1, dtype=torch.float64)
    images = rendered(pictures, dark, Pose(X_WO.q[:, None], X_WO.p[:, None]), one)
    given = replace(pictures, color=images.color[:, 0], alpha=images.alpha[:, 0])
    found = lit(given, first, X_WO)
    again = rendered(given, found, Pose(X_WO.q[:, None], X_WO.p[:, None]), one)
    plain = rendered(given, first, Pose(X_WO.q[:, None], X_WO.p[:, None]), one)
    errors = [float((image.color[:, 0] - given.color).square().mean()) for image in (plain, again)]
    assert errors[1] < 0.15 * errors[0]
