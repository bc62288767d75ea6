# SPDX-License-Identifier: MIT
"""Work of the stages of a lab's guide, each by the functions that the commands call; they return lines of notes.

Each takes the lab, a callback of its progress, and a flag: an interrupted run with the same input goes on.
"""

import itertools
import math
import os
import shutil
from contextlib import suppress
from pathlib import Path

from pinwm_drake.capture.check import check_capture
from pinwm_drake.capture.importers.video import VIDEO_SUFFIXES
from pinwm_drake.capture.scene import EPISODES, episode_names, load_capture
from pinwm_drake.capture.transforms import read_transforms
from pinwm_drake.documents import read_yaml
from pinwm_drake.errors import InputError
from pinwm_drake.experiments import training
from pinwm_drake.experiments.alignment import align
from pinwm_drake.experiments.masking import mask_capture, mask_push
from pinwm_drake.experiments.meshing import make_mesh, write_mesh_error
from pinwm_drake.experiments.next_push import next_push
from pinwm_drake.experiments.progress import Progress
from pinwm_drake.experiments.proposal import describe, write_proposal
from pinwm_drake.experiments.requests.train import TrainRequest
from pinwm_drake.experiments.start import start_pose, write_pose
from pinwm_drake.experiments.twins import identify
from pinwm_drake.files import occupying, prepare_folder
from pinwm_drake.guide.keep import keep, put_in_place
from pinwm_drake.guide.lab import LabFolder, write_scene
from pinwm_drake.identification.prior import prior_twin
from pinwm_drake.spatial.poses import Pose
from pinwm_drake.station.calibrate import calibrate
from pinwm_drake.station.episode import Sources, add_episode
from pinwm_drake.station.photos import pose_photos, write_photos
from pinwm_drake.twin.read import load_twin
from pinwm_drake.twin.twin import Twin
from pinwm_drake.twin.words import doubt_words, estimate_words

PROPOSAL_FILE = "push.yaml"  # of first/ and next/
MASKS, STAMPS = "masks", "stamps.csv"  # beside the film of a push
REPLACED = "replaced"  # of the capture: earlier episodes with files of a person that have no place in the new ones
_FEW = 6  # lines that are told one by one


def run_calibration(lab: LabFolder, progress: Progress, resume: bool = False) -> list[str]:
    """Calibrate the station."""
    found, _ = calibrate(lab.path, lab.station.parent, progress)
    return [found.accuracy.words(), *found.notes]


def run_photos(lab: LabFolder, progress: Progress, resume: bool = False) -> list[str]:
    """Find the poses of the photos, and write them as static views."""
    station = lab.read_station()
    if station is None:
        raise InputError(lab.station, value="no such file", allowed="that of pinwm calibrate")
    found = pose_photos(lab.photos, lab.read_lab(), station, progress)
    with occupying(lab.capture):
        before = read_transforms(lab.transforms) if lab.transforms.is_file() else []
        write_photos(lab.photos, found, lab.static)
        now = {frame.image_path for frame in read_transforms(lab.transforms)}
        for path in {frame.image_path for frame in before} - now:
            if path.parent == lab.static / "images":
                path.unlink(missing_ok=True)
    left = [f"doubtful: a photo is left out, {name}: fewer than 8 corners of the board" for name in found.left_out]
    return _few([f"{len(found.names)} photos; corners are {found.noise:.2f} px off on each axis", *left])


def run_scene(lab: LabFolder, progress: Progress, resume: bool = False) -> list[str]:
    """Write the scene of the lab to `capture.yaml`."""
    return write_scene(lab)


def run_masks(lab: LabFolder, progress: Progress, resume: bool = False) -> list[str]:
    """Cut the object out of the photos."""
    return _few(mask_capture(lab.capture, use_mesh=False, pushes=False, progress=progress).words())


def run_mesh(lab: LabFolder, progress: Progress, resume: bool = False) -> list[str]:
    """Make the mesh; of a file, the masks are then put where its outlines are."""
    progress("mesh", 0.0, "")
    new, aside = lab.mesh.with_name(f".{lab.mesh.name}"), _free(lab.capture / REPLACED / lab.mesh.name)
    found = make_mesh(lab.capture, source=lab.cad, out=new, replace=True)
    notes = _few(found.words())
    if put_in_place(new, lab.mesh, aside):
        notes.append(f"doubtful: the mesh that was there was edited or brought: it is now {aside}")
    notes += write_mesh_error(lab.capture, found.kind)
    progress("mesh", 1.0, notes[0])
    if found.kind == "file":
        notes += _few(mask_capture(lab.capture, pushes=False, progress=progress).words())
    return notes


def run_pose(lab: LabFolder, progress: Progress, resume: bool = False) -> list[str]:
    """Find the pose at the start."""
    progress("pose at the start", 0.0, "")
    found = start_pose(lab.capture)
    doubts = write_pose(lab.capture, found.X_WO)
    progress("pose at the start", 1.0, "")
    return found.words() + doubts


def run_appearance(lab: LabFolder, progress: Progress, resume: bool = False) -> list[str]:
    """Fit the surfels."""
    found = align(lab.capture, lab.twin, resume=resume, progress=progress)
    values = list((found.psnr_test or found.psnr_train).values())
    return [f"{found.surfels.num_surfels:,} surfels, {sum(values) / len(values):.1f} dB"]


def run_push(push: Path, lab: LabFolder, progress: Progress, resume: bool = False) -> list[str]:
    """Add a push as an episode, and cut the object out of its images.

    An earlier episode of the push stays until the new one is whole. What a person made in it is taken over, or else it
    stays below `replaced` of the capture.
    """
    video, log, masks = push_files(push)
    stamps = push / STAMPS if (push / STAMPS).is_file() else None
    columns = lab.read_object().columns
    camera = lab.station if lab.station.is_file() else None
    before, aside, left = lab.capture / EPISODES / push.name, _free(lab.capture / REPLACED / push.name), list[str]()
    sources = Sources(video, log, columns, camera=camera, masks=masks, stamps=stamps)
    added = add_episode(
        lab.capture,
        sources,
        name=push.name,
        aside=aside,
        finish=lambda now: left.extend(keep(before, now)),
        report=lambda what, share: progress(what, share, ""),
    )
    clock = added.clock
    low, high = (1e3 * (end - clock.offset) for end in clock.interval)
    notes = [f"{added.images} images; clock {clock.offset:+.4f} s, {low:+.1f} to {high:+.1f} ms (95 %)", *clock.notes]
    doubts = _earlier(aside, left)
    if not added.masked:
        progress("masks of the push", 0.0, push.name)
        masked = mask_push(lab.capture, push.name)
        progress("masks of the push", 1.0, f"{masked.written} masks")
        notes += _few(masked.words())
    return notes + doubts


def _earlier(aside: Path, left: list[str]) -> list[str]:
    """Words on the earlier episodes of a push that are set aside; the last one is removed where no file was left."""
    doubts = []
    if left:
        more = f" and {len(left) - 1} more files" if len(left) > 1 else ""
        doubts.append(f"doubtful: {left[0]}{more} belonged to other images: the earlier episode is now {aside}")
    else:
        shutil.rmtree(aside, ignore_errors=True)
        with suppress(OSError):  # others are in it, or it was never made
            aside.parent.rmdir()
    name = aside.stem.rpartition("-")[0]
    others = [one for one in sorted(aside.parent.glob("*-*")) if one != aside and one.suffix == aside.suffix]
    still = [one for one in others if one.stem.rpartition("-")[0] == name]
    return doubts + [f"doubtful: an earlier episode of the push is still in {one}" for one in still]


def _free(path: Path) -> Path:
    """Path with a number in its name that nothing has yet."""
    names = (path.with_name(f"{path.stem}-{k}{path.suffix}") for k in itertools.count(1))
    return next(one for one in names if not os.path.lexists(one))


def push_files(push: Path) -> tuple[Path, Path | None, Path | None]:
    """Film, log and masks in the folder of a push; no log where the film is a recording, masks where there are any.

    Raises:
        InputError: There is no film, or more than one film or log.
    """
    here = [path for path in sorted(push.iterdir()) if not path.name.startswith(".")]
    masks = next((path for path in here if path.stem == MASKS), None)
    logs = [path for path in here if path.suffix.lower() == ".csv" and path.name != STAMPS]
    films = [path for path in here if path not in logs and path != masks and path.name != STAMPS]
    if len(films) != 1 or len(logs) > 1:
        found = ", ".join(path.name for path in here) or "nothing"
        raise InputError(
            push, value=found[:80], allowed="one film (video, folder of images, recording) and one log.csv"
        )
    if not logs and films[0].suffix.lower() in VIDEO_SUFFIXES:
        raise InputError(push, value=f"{films[0].name} alone", allowed="the pusher's log.csv beside it")
    return films[0], logs[0] if logs else None, masks


def run_check(lab: LabFolder, progress: Progress, resume: bool = False) -> list[str]:
    """Check the capture; errors are raised, the first of them."""
    parts = 0

    def told(part: str) -> None:
        nonlocal parts
        parts += 1
        progress("checking the capture", 1.0 - 1.0 / parts, part)

    found = check_capture(lab.capture, told)
    progress("checking the capture", 1.0, "")
    for one in found.problems:
        if one.severity == "error":
            raise one.problem
    return _few([f"doubtful: {one.problem}" for one in found.problems])


def run_identify(lab: LabFolder, progress: Progress, resume: bool = False) -> list[str]:
    """Identify the twin from all pushes."""
    names = episode_names(lab.capture)
    found = identify(lab.capture, lab.twin, episodes=names, resume=resume, progress=progress)
    notes = [f"from pushes {', '.join(names)}; loss {found.found.loss:.5f}"]
    for name, estimate in found.twin.theta.items():
        words = estimate_words(estimate)
        if estimate.identifiable:
            notes.append(f"{name} {words.value} {words.unit}, 95 % {words.interval}".replace("  ", " "))
    doubt = doubt_words(found.found.loss)
    return notes + ([f"doubtful: {doubt}"] if doubt else [])


def run_next_push(lab: LabFolder, progress: Progress, resume: bool = False) -> list[str]:
    """Propose the next push within the workspace."""
    return _propose(lab, load_twin(lab.twin), None, lab.next, progress)


def run_first_push(lab: LabFolder, progress: Progress, resume: bool = False) -> list[str]:
    """Propose the first push within the workspace, by what is likely before any was filmed."""
    capture = load_capture(lab.capture)
    return _propose(lab, prior_twin(capture), capture.object.X_WO, lab.first, progress)


def _propose(lab: LabFolder, twin: Twin, X_WO: Pose | None, folder: Path, progress: Progress) -> list[str]:
    station = lab.read_station()
    low, high, eye = (-math.inf, -math.inf), (math.inf, math.inf), None
    if station is not None:
        box = station.document.workspace
        low, high = box.low[:2], box.high[:2]
        eye = station.X_WC.p.numpy() if station.document.camera.mount == "fixed" else None
    told = f"{folder.name} push"
    proposal = next_push(twin, X_WO=X_WO, low=low, high=high, eye=eye, report=lambda share: progress(told, share, ""))
    write_proposal(prepare_folder(folder), twin, proposal)
    return describe(twin, proposal)


def is_good_enough(lab: LabFolder) -> bool:
    """Flag: the last proposal says that no further push is needed."""
    path = lab.next / PROPOSAL_FILE
    said = read_yaml(path).find("good_enough") if path.is_file() else None
    return said is not None and said.value is True


def run_policy(lab: LabFolder, progress: Progress, _: bool = False) -> list[str]:
    """Train a policy in copies of the twin, for the station's camera; an interrupted training goes on."""
    resume, station = training.can_go_on(lab.policy), lab.station if lab.station.is_file() else None
    request = TrainRequest(scene=str(lab.twin), out=lab.policy, station=station, resume=resume)
    policy = training.train(
        request, report=lambda step: progress(step.stage, step.done, f"{step.steps:,} steps, best {step.best:.0%}")
    )
    return [f"trained: {policy.provenance.get('time', '')}"]


def _few(lines: list[str]) -> list[str]:
    return lines if len(lines) <= _FEW else [*lines[:_FEW], f"doubtful: {len(lines) - _FEW} more lines"]
