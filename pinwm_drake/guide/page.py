# SPDX-License-Identifier: MIT
"""The page of a lab, `lab.html`: the next act, all acts of a person, and each stage with pictures."""

from pinwm_drake.errors import PinwmError
from pinwm_drake.guide.lab import LabFolder
from pinwm_drake.guide.pictures import Picture, pictures_of
from pinwm_drake.guide.stages import ACTS, MESH
from pinwm_drake.guide.status import Guided, Status
from pinwm_drake.provenance import timestamp
from pinwm_drake.report.page import write_page

PAGE_FILE = "lab.html"
_ROW = 3  # pictures beside each other


def write_lab_page(lab: LabFolder, found: Guided) -> None:
    """Write the page of a lab into its folder.

    Raises:
        InputError: The file cannot be written.
    """
    write_page(
        lab.path / PAGE_FILE,
        "guide/page.html",
        name=lab.path.resolve().name,
        created=timestamp(),
        found=found,
        acts=list(zip(ACTS, act_states(found), strict=True)),
        stages=[(status, *_rows(lab, status)) for status in found.seen],
    )


def act_states(found: Guided) -> list[str]:
    """State of each act of a person: "done", "next", "optional" or "later"."""
    states = ["later"] * len(ACTS)
    for status in found.seen:
        for act in status.stage.acts:
            before = status.stage.missing is not None and act < status.stage.missing
            if status.state != "missing" or before:
                states[act] = "done"
    if found.number is not None:
        states[found.number - 1 :] = ["next", *["later"] * (len(ACTS) - found.number)]
    if states[MESH] != "later":
        states[MESH] = "optional"
    return states


def _rows(lab: LabFolder, status: Status) -> tuple[list[list[Picture]], str]:
    """Rows of the pictures of a stage, and why there are none."""
    if status.state != "done":
        return [], ""
    try:
        pictures = pictures_of(lab, status.stage.key)
    except PinwmError as error:
        return [], str(error)
    return [pictures[k : k + _ROW] for k in range(0, len(pictures), _ROW)], ""
