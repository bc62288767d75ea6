# SPDX-License-Identifier: MIT
"""The guide: runs the stages that are ready, stops at the first that needs a person, and says what comes next."""

import time
import warnings
from pathlib import Path

import pinwm_drake
from pinwm_drake.errors import InputError, PinwmError
from pinwm_drake.experiments.progress import Progress, silent
from pinwm_drake.files import occupying
from pinwm_drake.guide.lab import LabFolder
from pinwm_drake.guide.page import write_lab_page
from pinwm_drake.guide.record import Entry, Record
from pinwm_drake.guide.stages import ACTS, AGAIN, EXPORT, Stage, stages
from pinwm_drake.guide.status import Guided, State, Status
from pinwm_drake.station.lab import LAB_FILE

_INTERRUPTED = "interrupted"


def guide_lab(path: Path, *, train: bool = False, run: bool = True, progress: Progress = silent) -> Guided:
    """Run what is ready in a lab's folder, and write its page.

    Args:
        path: The lab's folder, as `pinwm lab new` makes it.
        train: Flag: a policy is trained, where all before it is done.
        run: Flag: stages are run; else they are only looked at.
        progress: Called with the stages of the work that is run.

    Raises:
        InputError: There is no lab in the folder, its record is damaged, or another run is at work.
    """
    lab = LabFolder(path)
    if not path.is_dir() or not (lab.station.is_file() or (path / LAB_FILE).is_file() or lab.capture.is_dir()):
        raise InputError(path, value="no lab", allowed=f"a lab's folder; pinwm lab new {path} makes one")
    with occupying(path):
        record = Record.read(path)
        found = _walk(lab, record, train, run, progress)
        write_lab_page(lab, found)
        return found


def _walk(lab: LabFolder, record: Record, train: bool, run: bool, progress: Progress) -> Guided:
    """Look at stages one after the other and run those that are ready."""
    seen: list[Status] = []
    try:
        for stage in stages(lab):
            status = look(stage, record)
            if status.state == "missing" and stage.missing == AGAIN and train:
                status = Status(stage, "done", notes=("left out, as a policy is asked for",))
            if status.state in ("ready", "out of date", "interrupted", "failed") and run and (train or not stage.asked):
                status = _run(lab, stage, record, progress)
            seen.append(status)
            if status.state != "done":
                return Guided(lab.path, seen, _next_act(status), status.error)
    except PinwmError as error:  # a file that tells the state of a stage is refused
        return Guided(lab.path, seen, "Mend what is refused, and call pinwm lab again.", str(error))
    return Guided(lab.path, seen, ACTS[EXPORT], "")


def _next_act(status: Status) -> str:
    """The act of a person that comes next, in words."""
    if status.state == "failed":
        return "Mend what is refused, and call pinwm lab again."
    if status.stage.missing is not None:
        return ACTS[status.stage.missing]
    return "Nothing: pinwm lab runs what is ready."


def look(stage: Stage, record: Record) -> Status:
    """State of a stage by its files and the record."""
    entry = record.entries.get(stage.key)
    if stage.missing is not None and not stage.asked:
        return Status(stage, "done" if stage.made else "missing", () if entry is None else entry.notes)
    if stage.run is None:
        return Status(stage, "done")
    if entry is None:
        given = stage.made and stage.leaves
        return Status(stage, "done" if given else "ready", ("made elsewhere",) if given else ())
    changed = record.changed(stage.key, record.fingerprint(stage.key, stage.inputs))
    state: State = "done"
    if changed:
        state = "out of date"
    elif entry.error:
        state = "interrupted" if entry.error == _INTERRUPTED else "failed"
    elif not stage.made:
        state = "ready"
    error = entry.error if state == "failed" else ""
    return Status(stage, state, entry.notes, error, tuple(changed), entry.seconds)


def _run(lab: LabFolder, stage: Stage, record: Record, progress: Progress) -> Status:
    """Run a stage, and put it into the record with the hashes of its input."""
    assert stage.run is not None
    before, inputs = record.entries.get(stage.key), record.fingerprint(stage.key, stage.inputs)
    resume = before is not None and before.error == _INTERRUPTED and not record.changed(stage.key, inputs)
    record.put(stage.key, Entry(inputs, error=_INTERRUPTED))
    begun, error, notes = time.monotonic(), "", list[str]()
    with warnings.catch_warnings(record=True) as told:
        warnings.simplefilter("always", UserWarning)
        try:
            notes = stage.run(lab, progress, resume)
        except PinwmError as problem:
            error = str(problem)
    package = Path(pinwm_drake.__file__).parent
    notes += [f"doubtful: {one.message}" for one in told if Path(one.filename).is_relative_to(package)]
    entry = Entry(inputs, tuple(dict.fromkeys(notes)), error, time.monotonic() - begun)
    record.put(stage.key, entry)
    return Status(stage, "failed" if error else "done", entry.notes, error, (), entry.seconds)
