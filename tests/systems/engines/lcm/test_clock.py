"""What is known of the time at which a message was sent."""

import math

from pinwm_drake.systems.engines.lcm.clock import Heard

TIMEOUT = 0.1


def hear(*messages: tuple[float, float]) -> Heard:
    """What is known after messages of (stamp, arrival), s."""
    heard = Heard()
    for stamp, arrival in messages:
        heard = heard.hear(round(1e6 * stamp), arrival, TIMEOUT)
    return heard


def test_nothing_is_known_before_the_first_message():
    assert Heard().time == -math.inf


def test_clocks_that_are_apart():
    # The sender's clock is 100 s behind; the second message took 20 ms less than the first and the third.
    first, second, third = (5.0, 105.03), (5.05, 105.06), (5.1, 105.13)
    assert math.isclose(hear(first).time, 105.03)
    assert math.isclose(hear(first, second).time, 105.06)
    assert math.isclose(hear(first, second, third).time, 105.11)


def test_a_message_that_is_repeated_or_overtaken_says_nothing():
    heard = hear((1.0, 1.0), (1.05, 1.05))
    assert heard.hear(1_050_000, 1.2, TIMEOUT) is heard
    assert heard.hear(1_000_000, 1.06, TIMEOUT) is heard


def test_a_sender_that_begins_again_is_heard_after_a_silence():
    heard = hear((50.0, 1.0))
    assert heard.hear(0, 1.05, TIMEOUT) is heard
    again = heard.hear(0, 1.2, TIMEOUT)
    assert again.stamp == 0
    assert again.time == 1.2


def test_messages_that_are_held_up_show_as_old():
    # One a tenth of a second, each 50 ms later than the last: the sender's clock goes too slowly, or a queue grows.
    heard = hear(*((0.1 * k, 0.15 * k) for k in range(5)))
    assert math.isclose(0.6 - heard.time, 0.2)
