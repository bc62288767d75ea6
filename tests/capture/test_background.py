# SPDX-License-Identifier: MIT
import io

import numpy as np
import pytest
from PIL import Image

from pinwm_drake.capture.background import cut_out, on_white
from pinwm_drake.capture.images import read_image
from pinwm_drake.errors import InputError

SIZE = 160
Y, X = np.mgrid[:SIZE, :SIZE] + 0.5
# A disc with a hole, beside a bar.
RADIUS = np.hypot(X - 70, Y - 80)
TRUTH = ((RADIUS < 48) & (RADIUS > 14)) | ((np.abs(X - 122) < 12) & (np.abs(Y - 80) < 40))
WHITE = np.full((SIZE, SIZE, 3), 255.0)


def iou(one, other):
    return (one & other).sum() / (one | other).sum()


def object_of(colour):
    """A picture of the object alone, shaded from left to right."""
    return np.array(colour) * (0.7 + 0.3 * X / SIZE)[..., None]


def composed(colour, behind):
    return np.where(TRUTH[..., None], object_of(colour), behind).clip(0, 255).astype(np.uint8)


def as_jpeg(pixels, quality, subsampling=2):
    data = io.BytesIO()
    Image.fromarray(pixels).save(data, "JPEG", quality=quality, subsampling=subsampling)
    return np.asarray(Image.open(data).convert("RGB"))


def found_or_refused(pixels):
    """The mask, or None where the background is refused."""
    try:
        return on_white("picture", pixels)
    except InputError:
        return None


COLOURS = {"dark": (60, 60, 60), "blue": (40, 90, 160), "yellow": (230, 210, 20)}


@pytest.mark.parametrize("quality", [75, 85, 95])
@pytest.mark.parametrize("colour", COLOURS.values(), ids=COLOURS)
def test_jpeg_on_white_is_found_whatever_its_ringing(colour, quality):
    mask = on_white("picture", as_jpeg(composed(colour, WHITE), quality))
    assert iou(mask, TRUTH) > 0.97


def test_coarser_jpeg_is_found_or_refused_where_colours_bleed():
    masks = {name: found_or_refused(as_jpeg(composed(colour, WHITE), 60)) for name, colour in COLOURS.items()}
    assert masks["dark"] is not None
    assert all(mask is None or iou(mask, TRUTH) > 0.97 for mask in masks.values())


@pytest.mark.parametrize(
    "colour", [(60, 60, 60), (160, 170, 165), (250, 249, 252)], ids=["dark", "light", "near white"]
)
def test_pictures_without_noise_show_the_object_wherever_they_are_not_white(colour):
    assert iou(on_white("picture", composed(colour, WHITE)), TRUTH) > 0.99


RAMP = np.repeat((255 - 40 * X / SIZE)[..., None], 3, -1)
SHADOW = np.repeat(np.round(255 - 90 * np.exp(-(((X - 80) / 30) ** 2) - ((Y - 125) / 12) ** 2))[..., None], 3, -1)


@pytest.mark.parametrize("behind", [WHITE - 55, WHITE - 5, RAMP, SHADOW], ids=["grey", "off-white", "ramp", "shadow"])
@pytest.mark.parametrize("quality", [None, 60, 90])
def test_other_backgrounds_are_found_or_refused_and_never_wrong(behind, quality):
    pixels = composed((60, 80, 120), behind)
    mask = found_or_refused(pixels if quality is None else as_jpeg(pixels, quality))
    assert mask is None or iou(mask, TRUTH) > 0.97


def test_grey_ramps_and_shadows_are_refused_by_name():
    for behind, part in (
        (WHITE - 55, "no white pixel"),
        (RAMP, "no white pixel|not plain white"),
        (SHADOW, "not plain white"),
    ):
        with pytest.raises(InputError, match=part):
            on_white("picture", composed((60, 80, 120), behind))


def test_a_bright_object_in_jpeg_is_found_or_refused():
    for level in (150, 190, 220, 235, 245, 250):
        for quality in (60, 90):
            mask = found_or_refused(as_jpeg(composed((level, level, level), WHITE), quality))
            assert mask is None or iou(mask, TRUTH) > 0.97, (level, quality)
    assert found_or_refused(as_jpeg(composed((245, 245, 245), WHITE), 90)) is None


def test_a_border_that_is_not_white_is_refused():
    pixels = composed((60, 80, 120), WHITE - 100)
    pixels[70:90, 70:90] = 255
    with pytest.raises(InputError, match="along 100% of the image's border"):
        on_white("picture", pixels)


def alpha(haze, seed=0):
    """Alpha of a cut-out that leaves a haze: from 0 to a share of 1."""
    noise = np.random.default_rng(seed).uniform(0, haze, TRUTH.shape)
    return np.where(TRUTH, 255, 255 * noise).astype(np.uint8)


@pytest.mark.parametrize("haze", [0.0, 0.01, 0.1, 0.2, 0.3])
def test_haze_of_a_cut_out_does_not_count(tmp_path, haze):
    np.testing.assert_array_equal(cut_out("picture", alpha(haze)), TRUTH)
    pixels = np.concatenate([composed((60, 80, 120), WHITE - 99), alpha(haze)[..., None]], axis=-1)
    Image.fromarray(pixels).save(tmp_path / "a.png")
    image, mask = read_image(tmp_path / "a.png")
    np.testing.assert_array_equal(mask, TRUTH)
    assert (image[~TRUTH] == 1).all()


def test_a_half_transparent_area_is_refused():
    with pytest.raises(InputError, match="half transparent"):
        cut_out("picture", np.where(TRUTH, 255, 130).astype(np.uint8))
    with pytest.raises(InputError, match="no pixel of alpha 128 or more"):
        cut_out("picture", np.where(TRUTH, 80, 0).astype(np.uint8))


def test_soft_outlines_of_a_cut_out_count_from_a_half(tmp_path):
    soft = (255 * (48.5 - RADIUS).clip(0, 1)).astype(np.uint8)
    assert iou(cut_out("picture", soft), RADIUS < 48) > 0.99


def test_masks_of_zeros_and_ones_are_refused(tmp_path):
    Image.fromarray(composed((60, 60, 60), WHITE)).save(tmp_path / "a.png")
    Image.fromarray(TRUTH.astype(np.uint8)).save(tmp_path / "mask.png")
    with pytest.raises(InputError, match="largest value is 1; allowed: 0, and 128 to 255"):
        read_image(tmp_path / "a.png", tmp_path / "mask.png")
