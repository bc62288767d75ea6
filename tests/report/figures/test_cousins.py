# SPDX-License-Identifier: MIT
import dataclasses

import cv2
import numpy as np
import pytest

from pinwm_drake.cousins.cousin import draw_cousins
from pinwm_drake.errors import InputError
from pinwm_drake.report.figures import cousins as module
from pinwm_drake.report.figures.cousins import cousin_figure
from tests.twin.samples import cube_twin, estimates


def draw(path, cousins):
    cousin_figure(path, cousins)
    return cv2.imread(str(path))


@pytest.fixture(scope="module")
def twin(tmp_path_factory):
    return cube_twin(tmp_path_factory.mktemp("twin"))


def test_every_cousin_has_its_place(twin, tmp_path):
    images = {n: draw(tmp_path / f"{n}.png", draw_cousins(twin, n, 0.3)) for n in (1, 5, 6)}
    assert all(image.std() > 10 for image in images.values())
    # The twin and five cousins fill a row; another one begins a second.
    assert images[1].shape[1] < images[5].shape[1] == images[6].shape[1]
    assert images[5].shape[0] < 0.7 * images[6].shape[0]
    other = draw(tmp_path / "other.png", draw_cousins(twin, 5, 0.3, seed=1))
    assert other.shape == images[5].shape
    assert (other != images[5]).any(axis=2).mean() > 0.01


def test_a_cousin_is_shown_beside_the_twin_with_what_differs(twin, tmp_path, monkeypatch):
    drawn = []
    monkeypatch.setattr(module, "_draw", lambda axes, *given: drawn.append(given))
    cousins = draw_cousins(dataclasses.replace(twin, theta=estimates(mass=0.2, friction_floor=0.3)), 3, 0.5)
    cousin_figure(tmp_path / "a.png", cousins)
    assert [given[1] for given in drawn] == ["the twin", "cousin 0", "cousin 1", "cousin 2"]
    height = len(drawn[0][0]) // 2
    first, grey = drawn[0][0][:height], drawn[0][0][height:]
    assert (grey == 0.5).all()
    for (picture, _, lines, _), cousin in zip(drawn[1:], cousins.members, strict=True):
        difference = (picture[:height] - first).numpy()
        assert 0.02 < np.abs(difference).max() < 0.6
        np.testing.assert_allclose(picture[height:].numpy(), 0.5 + 5 * difference, atol=1e-5)
        mass, friction = cousin.theta["mass"], cousin.theta["friction_floor"]
        assert lines[0] == f"m {mass:.3g} kg ({100 * (mass / 0.2 - 1):+.0f} %)"
        assert lines[4] == f"μ floor {friction:.3g} ({100 * (friction / 0.3 - 1):+.0f} %)"
        assert len(lines) == 7  # a restitution of 0 stays 0
    assert drawn[0][2][4] == "μ floor 0.3"


def test_the_title_says_how_they_were_drawn(twin):
    words = module._title(draw_cousins(twin, 2, 0.2, seed=7))
    assert words.splitlines()[0] == "cube: 2 cousins, ±20 %, seed 7"
    assert words.endswith("of the colours kept back to be displayable")
    words = module._title(draw_cousins(twin, 2, from_intervals=True))
    assert "from identified intervals: m, Ixx, Iyy, Izz, μ floor, μ pusher, e floor, e pusher\n" in words
    plain = dataclasses.replace(twin, theta=estimates(**{key: one.value for key, one in twin.theta.items()}))
    assert "none, as the twin has none" in module._title(draw_cousins(plain, 2, from_intervals=True))


def test_without_delta_everything_is_named(twin, tmp_path):
    assert draw(tmp_path / "a.png", draw_cousins(twin, 2, 0.0)).std() > 10


def test_a_file_that_cannot_be_written_is_named(twin, tmp_path):
    with pytest.raises(InputError, match="none"):
        draw(tmp_path / "none/a.png", draw_cousins(twin, 1))
