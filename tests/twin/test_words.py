# SPDX-License-Identifier: MIT
import math

import pytest

from pinwm_drake.twin.twin import Estimate
from pinwm_drake.twin.words import EstimateWords, estimate_words


@pytest.mark.parametrize(
    ("value", "interval", "unit", "expected"),
    [
        (0.02934854, (0.02285646, 0.03593481), "1", ("0.029", "0.023 to 0.036", "")),
        (-0.00118226, (-0.00365059, 0.00104718), "m", ("-1.2", "-3.7 to 1.0", "mm")),
        (0.00194273, (0.00169793, 0.00225674), "kg m^2", ("19.4", "17.0 to 22.6", "kg cm²")),
        (0.00084022, (-0.01720474, 0.0165224), "rad", ("0.0", "-1.0 to 0.9", "°")),
        (-0.0016621, (-0.01755439, 0.01566023), "s", ("-2", "-18 to 16", "ms")),
        (0.005, (0.005, 0.005), "m", ("5", "5 to 5", "mm")),
        (0.005, (0.005, 0.0050000001), "m", ("5", "5 to 5", "mm")),
        (1.0, None, "kg", ("1", "", "kg")),
        (0.0, (-math.inf, math.inf), "m", ("0", "−∞ to ∞", "mm")),
    ],
)
def test_an_estimate_has_a_handy_unit_and_the_digits_of_its_interval(value, interval, unit, expected):
    assert estimate_words(Estimate(value, interval, False, unit)) == EstimateWords(*expected)
