"""How a station and a robot's driver find each other over LCM: the address, the channels, and how often they speak."""

from pydrake.lcm import DrakeLcm

from pinwm_drake.errors import ParameterError
from pinwm_drake.systems.scenario.schema import LOCAL, MEMORY, LcmLink


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
