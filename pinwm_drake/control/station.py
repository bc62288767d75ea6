# SPDX-License-Identifier: MIT
"""Whether a bundle is for the station that it is to run at; without the packages that read a station."""

import hashlib
from pathlib import Path

from pinwm_drake.errors import InputError
from pinwm_drake.reading.contents import read_bytes

_FILE = "station.yaml"


def check_station(bundle: str | Path, named: str | None, station: str | Path | None) -> None:
    """Refuse a bundle for another station.

    Args:
        bundle: Name or folder of the bundle, for messages.
        named: SHA-256 of the station that the bundle names; None for none, which runs anywhere.
        station: The `station.yaml` here, or its folder; None where it is not known.

    Raises:
        InputError: The file cannot be read, or the bundle names another station, or one where none is known.
    """
    if station is None:
        if named is not None:
            allowed = f"the station.yaml whose SHA-256 begins with {named[:12]}"
            raise InputError(bundle, value="no station, where the policy is for one alone", allowed=allowed)
        return
    path = Path(station)
    path = path / _FILE if path.is_dir() else path
    found = hashlib.sha256(read_bytes(path)).hexdigest()
    if named not in (None, found):
        raise InputError(bundle, value=f"a policy for station {named[:12]}", allowed=f"{found[:12]}, which {path} is")
