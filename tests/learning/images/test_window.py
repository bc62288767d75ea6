# SPDX-License-Identifier: MIT
import dataclasses

import numpy as np
import pytest
import torch

from pinwm_drake.errors import ParameterError
from pinwm_drake.learning.bundle import read_bundle
from pinwm_drake.learning.golden import TOLERANCE
from pinwm_drake.learning.images.window import Window, part_size, window_size
from pinwm_drake.learning.policy import make_actor, read_policy, write_policy
from pinwm_drake.learning.spec import PolicySpec
from pinwm_drake.tasks.flip import FlipTask
from tests.learning.bundles import SCENE, exported, image_spec, untrained_policy

SPEC = image_spec(48, scene=SCENE, window=16)


def dark_square(x, y, side=7, size=48):
    """One stack (1, size, size, 6) of a square around a pixel, in both images."""
    image = torch.full((1, size, size, 6), 255, dtype=torch.uint8)
    image[:, y - side // 2 : y + side // 2 + 1, x - side // 2 : x + side // 2 + 1] = 51
    return image


def test_it_shows_what_is_dark_wherever_that_is_and_background_beyond_the_image():
    window = Window(SPEC)
    seen = [window(dark_square(x, y))[0] for x, y in ((20, 20), (40, 8), (3, 44))]
    assert seen[0].shape == (1, 6, 16, 16)
    assert seen[0].sum() == pytest.approx(6 * 49 * 0.8)
    for other in seen[1:]:
        assert torch.equal(other, seen[0])


def test_all_images_are_cut_where_the_newest_has_something():
    stack = dark_square(20, 24)
    stack[..., :3] = dark_square(23, 24)[..., :3]
    window = Window(SPEC)(stack)[0]
    assert torch.equal(window[:, :3, :, 3:], window[:, 3:, :, :-3])


def test_its_place_is_where_the_line_of_sight_meets_the_middle_of_the_object():
    camera, window = SPEC.camera, Window(SPEC)
    level = SCENE.floor_height + 0.025
    for x, y in ((10, 30), (40, 20)):
        _, place = window(dark_square(x, y))
        # The camera looks straight down from 1 m, its x the world's, its y the other way.
        far = 1.0 - level
        expected = far * np.array([(x + 0.5 - camera.cx) / camera.fx, -(y + 0.5 - camera.cy) / camera.fy])
        assert place[0].numpy() == pytest.approx(expected, abs=1e-6)


def test_images_without_anything_are_cut_in_their_middle():
    window, place = Window(SPEC)(torch.full((2, 48, 48, 6), 255, dtype=torch.uint8))
    assert not window.any()
    assert place.abs().max() < 0.02


def test_its_size_follows_from_the_object_and_the_camera():
    spec = image_spec(128, scene=SCENE)
    diagonal = np.linalg.norm(SCENE.object.size) * spec.camera.fx / (1.0 - SCENE.floor_height)
    side = window_size(spec)
    assert side % 4 == 0
    assert 1.7 * diagonal <= side < 1.7 * diagonal + 4
    small = dataclasses.replace(SCENE.object, size=(1.0, 1.0, 1.0))
    assert window_size(dataclasses.replace(spec, scene=dataclasses.replace(SCENE, object=small))) is None
    assert window_size(image_spec(128)) is None


def test_one_image_by_itself_needs_less_room_than_a_stack():
    alone = dataclasses.replace(image_spec(128, frames=3, scene=SCENE), history=2)
    assert window_size(alone) < window_size(image_spec(128, scene=SCENE))


@pytest.mark.parametrize("at", [(24, 20), (5, 44), (46, 3)])
def test_the_window_of_a_part_is_that_of_the_image(at):
    window, image = Window(SPEC), dark_square(*at)[..., :3]
    part, corner = window.part(image)
    assert part.shape == (1, 24, 24, 3)
    assert part_size(dataclasses.replace(SPEC, frames=3, history=2)) == (24, 24)
    assert part_size(SPEC) == (48, 48)
    for tint in (None, torch.ones(1, 3)):
        for found, expected in zip(window(part, corner, tint), window(image), strict=True):
            torch.testing.assert_close(found, expected)
    light = window(part, corner, torch.tensor([[0.5, 1.0, 3.0]]))[0]
    dark = window(image)[0]
    torch.testing.assert_close(light, torch.stack([0.5 * dark[:, 0], dark[:, 1], (3.0 * dark[:, 2]).clamp(max=1.0)], 1))
    nothing = torch.full((1, 48, 48, 3), 255, dtype=torch.uint8)
    assert not window(*window.part(nothing))[0].any()


def test_images_of_a_history_are_seen_one_by_one_and_their_parts_are_enough():
    spec = dataclasses.replace(SPEC, frames=3, history=2)
    torch.manual_seed(0)
    actor, places = make_actor(spec), ((20, 24), (26, 22), (34, 30))
    a, b, c = (dark_square(*at)[..., :3] for at in places)
    pusher = torch.rand(1, 10) - 0.5  # now, and twice the pusher and the action
    with torch.no_grad():
        state = actor.state(torch.cat([a, b, c], 3), pusher)
        earlier = actor.state(torch.cat([a, a, b], 3), torch.cat([pusher[:, 2:4], pusher[:, 2:]], 1))
        parts, corners = zip(*(actor.parts(one.numpy()) for one in (a, b, c)), strict=True)
        stack, corner = torch.from_numpy(np.concatenate(parts, 3)), torch.from_numpy(np.stack(corners, 1))
        of_parts = actor.state(stack, pusher, corner=corner)
        tinted = actor.state(stack, pusher, corner=corner, tint=torch.ones(1, 3))
    size = spec.task.state_size
    torch.testing.assert_close(state[:, size : 2 * size], earlier[:, :size])
    assert torch.equal(state[:, 2 * size : 2 * size + 2], pusher[:, 4:6])
    torch.testing.assert_close(of_parts, state)
    torch.testing.assert_close(tinted, state)


@pytest.mark.parametrize("changes", [{"window": 0}, {"window": 49}, {"window": 16, "scene": None}])
def test_windows_that_cannot_be_are_refused(changes):
    with pytest.raises(ParameterError, match="window"):
        Window(image_spec(48, **{"scene": SCENE, **changes}))


def test_a_policy_with_a_window_is_read_back_and_its_document_names_it(tmp_path):
    policy = untrained_policy(SPEC)
    write_policy(tmp_path, policy)
    known = read_policy(tmp_path)
    assert known.spec == SPEC
    assert "window" not in image_spec(48, scene=SCENE).to_document()
    assert PolicySpec.from_document(image_spec(48, scene=SCENE).to_document()).window is None


@pytest.mark.parametrize("task", ["push", "flip"])
def test_an_estimate_of_nothing_is_the_place_that_the_window_shows(task):
    flip = {"task": FlipTask(), "pusher_low": (-0.3, -0.2, 0.0), "pusher_high": (0.3, 0.2, 0.3)}
    spec = dataclasses.replace(SPEC, **(flip if task == "flip" else {}))
    actor = make_actor(spec)
    with torch.no_grad():
        actor.estimate[-1].weight.zero_()
        actor.estimate[-1].bias.zero_()
        image = dark_square(34, 14)
        state = actor.state(image, torch.zeros(1, spec.action_size))
        place = actor.window(image)[1][0].numpy()
    where = spec.task.object_state(state.numpy() if task == "push" else np.where(state == 0, 1e-3, state))[0][0, 4:6]
    assert where == pytest.approx(place, abs=1e-3)


def test_a_bundle_with_a_window_does_what_its_policy_does(tmp_path):
    policy = untrained_policy(SPEC)
    bundle = read_bundle(exported(tmp_path / "bundle", policy))
    images = torch.cat([dark_square(x, 20) for x in range(4, 46, 3)]).numpy()
    longest = 0
    for image in images:
        action = policy.predict({"image": image, "pusher": np.zeros(2)})[0].astype(float)
        middle = 0.5 * (np.array(SPEC.pusher_low) + SPEC.pusher_high)
        wanted = SPEC.max_translation * action / max(1.0, float(np.hypot(*action)))
        assert bundle.act(image, middle) == pytest.approx(wanted, abs=TOLERANCE)
        longest = max(longest, float(np.abs(wanted).max()))
    assert longest > 0.1 * SPEC.max_translation


def test_images_of_floats_are_seen_as_those_of_bytes():
    window, image = Window(SPEC), dark_square(30, 12)
    for found, expected in zip(window(image.float()), window(image), strict=True):
        torch.testing.assert_close(found, expected)
