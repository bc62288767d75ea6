import pytest
from scipy.stats import binomtest

from pinwm_drake.errors import ParameterError
from pinwm_drake.learning.wilson import wilson_interval


@pytest.mark.parametrize(
    ("successes", "episodes", "low", "high"),
    # Newcombe, "Two-sided confidence intervals for the single proportion", Stat. Med. 17 (1998), table I, method 3.
    [(81, 263, 0.2553, 0.3662), (15, 148, 0.0624, 0.1605), (0, 20, 0.0, 0.1611), (1, 29, 0.0061, 0.1718)],
)
def test_it_is_that_of_the_table(successes, episodes, low, high):
    assert wilson_interval(successes, episodes) == pytest.approx((low, high), abs=5e-5)
    mirrored = wilson_interval(episodes - successes, episodes)
    assert mirrored == pytest.approx((1 - high, 1 - low), abs=5e-5)


@pytest.mark.parametrize("confidence", [0.5, 0.9, 0.99])
def test_it_is_that_of_scipy(confidence):
    for successes in (0, 1, 50, 98, 100):
        expected = binomtest(successes, 100).proportion_ci(confidence, method="wilson")
        assert wilson_interval(successes, 100, confidence) == pytest.approx((expected.low, expected.high), abs=1e-12)


def test_the_ends_are_exact():
    assert wilson_interval(0, 7)[0] == 0.0
    assert wilson_interval(7, 7)[1] == 1.0


@pytest.mark.parametrize(
    ("arguments", "words"),
    [((0, 0), "0 of 0"), ((3, 2), "3 of 2"), ((-1, 2), "-1 of 2"), ((1, 2, 1.0), "confidence: got 1.0")],
)
def test_what_is_no_rate_is_refused(arguments, words):
    with pytest.raises(ParameterError, match=words):
        wilson_interval(*arguments)
