# SPDX-License-Identifier: MIT
"""The request of an examination: what `pinwm doctor` does."""

from pathlib import Path
from typing import Annotated

from pinwm_drake.request import DATA, option, request


@request
class DoctorRequest:
    """Request of an examination."""

    out: Annotated[
        Path, option("Folder in which results will be written.", "--out", "-o", group=DATA, default="this one")
    ] = Path()
    json: Annotated[bool, option("Print the findings as JSON.", "--json")] = False
