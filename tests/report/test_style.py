# SPDX-License-Identifier: MIT
import pytest

from pinwm_drake.report.style import new_figure, tidy


@pytest.mark.parametrize(
    ("low", "high", "expected"),
    [(2.5, 9.0, list("3456789")), (0.3, 9.0, ["0.5", "1", "2", "5"]), (0.01, 9.0, ["0.01", "0.1", "1"])],
)
def test_a_logarithmic_scale_has_plain_numbers(low, high, expected):
    figure = new_figure(4, 3)
    axes = figure.subplots()
    axes.set(yscale="log", ylim=(low, high))
    tidy([axes])
    figure.canvas.draw()
    inside = [
        label.get_text()
        for label, at in zip(axes.get_yticklabels(), axes.get_yticks(), strict=True)
        if low <= at <= high * (1 + 1e-9)
    ]
    assert inside == expected
    assert not any(label.get_text() for label in axes.get_yticklabels(minor=True))
