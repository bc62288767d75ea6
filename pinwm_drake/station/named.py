# SPDX-License-Identifier: MIT
"""The station that a capture, twin or bundle names by a SHA-256; without the packages that read its contents."""

import hashlib
from pathlib import Path

from pinwm_drake.capture.paths import is_folder
from pinwm_drake.errors import InputError
from pinwm_drake.reading.contents import read_bytes
from pinwm_drake.reading.trees import MOST_YAML

STATION_FILE = "station.yaml"


def station_file(path: Path) -> Path:
    """File of a station, which is named itself or by its folder."""
    return path / STATION_FILE if is_folder(path) else path


def station_hash(path: Path) -> str:
    """SHA-256 of a station's file; InputError where it cannot be read."""
    return hashlib.sha256(read_bytes(station_file(path), MOST_YAML)).hexdigest()


def require_station(where: str | Path, named: str | None, found: str | None, path: str | Path | None) -> None:
    """Require a capture, twin or bundle to be of a station, or of none that it names.

    Args:
        where: File or folder that names the station.
        named: SHA-256 that it names; None for none.
        found: SHA-256 of the station; None where it is not known.
        path: The station's file or folder, for messages.

    Raises:
        InputError: Another station is named, or one where none is known.
    """
    if named is not None and found is None:
        raise InputError(where, value="no station", allowed=f"{named[:12]}..., by its {STATION_FILE}")
    if named is not None and found is not None and named != found:
        raise InputError(where, value=f"station {named[:12]}...", allowed=f"{found[:12]}..., that of {path}")
