# SPDX-License-Identifier: MIT
"""Connection of a station and a robot's driver over LCM, at the address that an `LcmLink` has."""

from pydrake.lcm import DrakeLcm

from pinwm_drake.errors import ParameterError
from pinwm_drake.systems.scenario.schema import LOCAL, MEMORY, LcmLink


def make_lcm(link: LcmLink) -> DrakeLcm:
    """Open the LCM address of a link.

    Messages over `memq://` reach those who share this object; those over `udpm://`, every process of this machine that
    listens there.

    Args:
        link: Link whose `url` is opened.

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
