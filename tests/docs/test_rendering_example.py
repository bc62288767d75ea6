# SPDX-License-Identifier: MIT
"""The example of docs/explanation/rendering.md, which renders a twin with a gradient to its pose."""

import re
from pathlib import Path

import torch

PAGE = Path(__file__).resolve().parents[2] / "docs/explanation/rendering.md"


def test_it_renders_the_twin_and_tells_how_the_object_shrinks_with_distance():
    code = re.search(r"```python\n(.*?)```", PAGE.read_text(encoding="utf-8"), re.DOTALL)[1]
    names: dict = {}
    exec(compile(code, PAGE.name, "exec"), names)
    image, gradient = names["image"], names["p_CO"].grad
    assert image.color.shape == (1, 200, 200, 3)
    # The T of 100 x 40 mm and 40 x 100 mm, at the depth of its nearer face, half a metre less 25 mm.
    covered = float(image.alpha.detach().sum())
    pixel = 0.475 / float(names["camera"].intrinsics[0])  # m
    assert abs(covered * pixel**2 / 0.0080 - 1.0) < 0.1
    assert torch.isfinite(gradient).all()
    # The area of a face in the image goes with 1 / z²; that of the sides, a part of what is seen, does not.
    assert abs(float(gradient[2]) / (-2.0 * covered / 0.475) - 1.0) < 0.3
