"""How a station and a robot's driver find each other over LCM: the address, the channels, and how often they speak."""

from dataclasses import dataclass, field
from typing import Any

from pydrake.lcm import DrakeLcm

from pinwm_drake.errors import ParameterError

MEMORY, LOCAL = "memq://", "udpm://239.255.76.67:7667?ttl=0"


def _seconds(default: float, low: float, high: float) -> Any:
    return field(default=default, metadata={"low": low, "high": high, "unit": "s"})


@dataclass
class LcmLink:
    """The messages between a station with `engine="lcm"` and the driver of a robot.

        station ── command_channel ─► driver    lcmt_drake_signal (3): v_WP [m/s], every `period`
        station ◄─ state_channel ──── driver    lcmt_drake_signal (6): p_WP [m], v_WP [m/s], every `period`
        station ◄─ image_channel ──── driver    lcmt_image_array of one RGBA image, every `image_period`

    World frame throughout; stamps in microseconds, of the sender's clock. The image is sRGB, its alpha 255 where the
    object is seen; whoever sends it has cut the object out. What has alpha 0 is white.

    Attributes:
        url: Where; `MEMORY` within a process, `LOCAL` between processes of this machine.
        command_channel: To the robot.
        state_channel: From the robot.
        image_channel: From its camera.
        period: s, between commands, and between states.
        image_period: s, between images.
        timeout: s. Commands that stop for longer stop the robot; a state that is older counts as unknown.
    """

    url: str = MEMORY
    command_channel: str = "PINWM_PUSHER_COMMAND"
    state_channel: str = "PINWM_PUSHER_STATE"
    image_channel: str = "PINWM_IMAGES"
    period: float = _seconds(0.005, 1e-3, 0.1)
    image_period: float = _seconds(0.05, 1e-3, 10.0)
    timeout: float = _seconds(0.1, 1e-3, 10.0)


def make_lcm(link: LcmLink) -> DrakeLcm:
    """Opens an address.

    What is sent over `memq://` reaches those who share this object; what is sent over `udpm://`, every process of this
    machine that listens there.

    Args:
        link: Whose `url` is opened.

    Raises:
        ParameterError: The address is another than memory and this machine, so that others could move the robot; or
            it cannot be opened.
    """
    url = link.url
    if url != MEMORY and not (url.startswith("udpm://") and url.endswith("?ttl=0")):
        raise ParameterError(f"lcm.url: got {url!r}; allowed: {MEMORY}, or udpm://ADDRESS:PORT?ttl=0 such as {LOCAL}")
    try:
        return DrakeLcm(url)
    except RuntimeError as error:
        raise ParameterError(f"lcm.url: got {url!r}, which LCM cannot open ({error}); allowed: {LOCAL}") from error
