# SPDX-License-Identifier: MIT
"""Stages of a lab's guide in their order: what each needs, what a person does for it, and what runs then."""

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from functools import partial
from pathlib import Path

from pinwm_drake.capture.scene import EPISODES, episode_names, load_unfinished
from pinwm_drake.capture.static_views import find_mask, is_picture
from pinwm_drake.capture.transforms import Frame, read_transforms
from pinwm_drake.documents import read_yaml
from pinwm_drake.experiments.masking import hand_made_masks
from pinwm_drake.experiments.progress import Progress
from pinwm_drake.guide import runs
from pinwm_drake.guide.lab import BOARD_FILE, FOUND, OBJECT_FILE, LabFolder
from pinwm_drake.guide.record import Given
from pinwm_drake.learning.policy import POLICY_FILE
from pinwm_drake.reading.pictures import opened_picture
from pinwm_drake.station.lab import LAB_FILE, POSES_FILE, SETS
from pinwm_drake.station.photos import FEWEST, FIXED
from pinwm_drake.twin.twin import SURFELS_FILE, TWIN_FILE

ACTS = (
    f"Print {BOARD_FILE} at 100 %, glue it to something flat, measure its ruler of 100 mm, and write the length in m "
    f"into {LAB_FILE} as ruler.",
    f"Fill in the rest of {LAB_FILE} (units of the robot, workspace, pusher) and {OBJECT_FILE} (name, mass).",
    "Take 10 to 15 photos of the board with the fixed camera, tilted in all directions and in all corners: put them "
    "into lens/.",
    "Fasten the board to the gripper and take 20 photos with the fixed camera: put them into robot/, and a row with "
    f"the robot's pose for each into {POSES_FILE}.",
    "Lay the board on the table, face up, at 6 places of the workspace, and take a photo of each with the fixed "
    "camera: put them into table/.",
    "Put the object on the table, mark its outline with tape, and lay the board beside it. Take 16 to 24 photos with a "
    "phone, zoom fixed, from all around, a third of them from near the table: put them into photos/. Take one with the "
    f"fixed camera: put it into photos/{FIXED}/.",
    "If there is a CAD file or a scan of the object, put it into mesh/. Without one the mesh is the hull of the masks.",
    "Take the board away and leave the object on its mark. Film the push of first/trajectory.csv, or one of your own, "
    "with the fixed camera while the robot logs its pusher in its base: put film and log.csv into pushes/0000/.",
    "Put the object back on its mark and film the push of next/trajectory.csv: put film and log.csv into pushes/0001/.",
    "Say that a policy is to be trained, which takes half an hour or more: pinwm lab LAB --train.",
    "Export the policy, rehearse it and connect your robot: pinwm export LAB/policy LAB/bundle, pinwm rehearse and "
    "docs/how-to/own-robot.md.",
)
"""Acts of a person in the whole way, of which one is optional."""
PRINT, FILL_IN, LENS, ROBOT, TABLE, PHOTOS, MESH, PUSH, AGAIN, TRAIN, EXPORT = range(len(ACTS))
_FEWEST = (5, 6, 3)  # photos of the sets
_Run = Callable[[LabFolder, Progress, bool], list[str]]


@dataclass(frozen=True)
class Stage:
    """Stage of the way from a lab to a policy.

    Attributes:
        key: Its name in the record.
        title: Its title.
        acts: Numbers of a person's acts that it needs.
        missing: Number of the act that comes next; None where all is there.
        inputs: Its input.
        made: Flag: its result is there.
        run: Its work; None where a person does all of it.
        command: Command line that does the same; "" for none.
        asked: Flag: it runs only when it is asked for.
        leaves: Flag: it leaves files, and those of others are taken.
    """

    key: str
    title: str
    acts: tuple[int, ...]
    missing: int | None
    inputs: tuple[Given, ...]
    made: bool
    run: _Run | None
    command: str = ""
    asked: bool = False
    leaves: bool = True


def stages(lab: LabFolder) -> Iterator[Stage]:
    """Stages of a lab as its files are now; each is looked at when the iteration comes to it.

    Raises:
        InputError: A file that tells the state of a stage is refused.
    """
    p, c = lab.path, lab.capture
    brought = lab.station.is_file() or (lab.transforms.is_file() and lab.scene.is_file())
    unwritten = None if brought and not (p / LAB_FILE).is_file() else _unwritten(lab)
    yield Stage("board", "Board and settings", (PRINT, FILL_IN), unwritten, (), unwritten is None, None)
    sets = lab.pictures(*SETS)
    yield Stage(
        "calibration",
        "Calibration of the station",
        (LENS, ROBOT, TABLE),
        _too_few(lab),
        _there(p / LAB_FILE, p / POSES_FILE, *sets),
        brought,
        runs.run_calibration,
        f"pinwm calibrate {p}",
    )
    photos = lab.pictures("photos", f"photos/{FIXED}")
    enough = len(lab.pictures("photos")) >= FEWEST and len(lab.pictures(f"photos/{FIXED}")) > 0
    yield Stage(
        "photos",
        "Photos of the object",
        (PHOTOS,),
        None if enough else PHOTOS,
        _there(lab.station, *photos),
        lab.transforms.is_file(),
        runs.run_photos,
    )
    yield Stage(
        "scene",
        "Object, pusher and table",
        (),
        None,
        _there(lab.station, p / OBJECT_FILE),
        lab.scene.is_file(),
        runs.run_scene,
    )
    frames = read_transforms(lab.transforms) if lab.transforms.is_file() else []
    views = [frame.image_path for frame in frames]
    yield Stage(
        "masks",
        "Masks",
        (),
        None,
        _there(lab.transforms, *views, *hand_made_masks(lab.static)),
        bool(frames) and all(_is_cut_out(lab.static, frame) for frame in frames),
        runs.run_masks,
        f"pinwm mask {c} --no-mesh",
    )
    cad, masks = lab.cad, _masks(lab.static, frames)
    yield Stage(
        "mesh",
        "Mesh",
        (MESH,),
        None,
        (*_there(lab.transforms, *([cad] if cad else [*masks, *_pictures(lab.static / "depth")])), _scene(lab)),
        lab.mesh.is_file(),
        runs.run_mesh,
        f"pinwm mesh {c}{f' --from {cad}' if cad else ''} --replace",
    )
    pose = bool(lab.read_scene().get("object", {}).get("X_WO"))
    yield Stage(
        "pose",
        "Pose at the start",
        (),
        None,
        (*_there(lab.transforms, lab.mesh, *masks), _scene(lab)),
        pose,
        runs.run_pose,
        f"pinwm pose {c}",
    )
    shown = _there(lab.transforms, lab.mesh, lab.scene, *views, *_masks(lab.static, frames))
    fitted = (lab.twin / SURFELS_FILE).is_file()
    yield Stage("appearance", "Appearance", (), None, shown, fitted, runs.run_appearance, f"pinwm align {c} {lab.twin}")
    pusher = _pusher(lab)
    yield from _pushes(lab, pusher)
    episodes = _below(c / EPISODES)
    yield Stage(
        "check",
        "Check of the capture",
        (),
        None,
        (*shown, *pusher, *episodes),
        True,
        runs.run_check,
        f"pinwm capture check {c}",
        leaves=False,
    )
    chosen = "".join(f" --episode {name}" for name in episode_names(c))
    yield Stage(
        "twin",
        "Twin",
        (),
        None,
        _there(lab.scene, lab.mesh, *pusher, lab.twin / SURFELS_FILE, *episodes),
        (lab.twin / TWIN_FILE).is_file(),
        runs.run_identify,
        f"pinwm identify {c} {lab.twin}{chosen}",
    )
    proposed = (lab.next / runs.PROPOSAL_FILE).is_file()
    twin = _there(lab.twin / TWIN_FILE)
    yield Stage(
        "next", "Next push", (), None, twin, proposed, runs.run_next_push, f"pinwm next-push {lab.twin} -o {lab.next}"
    )
    again = AGAIN if len(episode_names(c)) < 2 and not runs.is_good_enough(lab) else None
    yield Stage("again", "Second push", (AGAIN,), again, (), again is None, None)
    yield Stage(
        "policy",
        "Policy",
        (TRAIN, EXPORT),
        TRAIN,
        twin,
        (lab.policy / POLICY_FILE).is_file(),
        runs.run_policy,
        f"pinwm train {lab.twin}{f' --station {lab.station}' if lab.station.is_file() else ''} -o {lab.policy}",
        asked=True,
    )


def _pushes(lab: LabFolder, pusher: tuple[Path, ...]) -> Iterator[Stage]:
    """A stage for each push that was filmed, or one that asks for the first."""
    names = episode_names(lab.capture)
    if not lab.pushes and not names:
        proposed = (lab.first / runs.PROPOSAL_FILE).is_file()
        told: tuple[Given, ...] = (*_there(lab.station, lab.mesh, *pusher), (lab.scene.name, lab.read_scene()))
        command = f"pinwm next-push {lab.capture} -o {lab.first}"
        yield Stage("first", "First push", (), None, told, proposed, runs.run_first_push, command)
    if not lab.pushes:
        yield Stage("push", "Pushes", (PUSH,), PUSH, (), bool(names), None)
    for number, push in enumerate(lab.pushes):
        given = (*_below(push), *_there(lab.station, lab.path / OBJECT_FILE, lab.mesh, lab.scene, *pusher))
        made = lab.capture / EPISODES / push.name
        acts = (PUSH,) if number == 0 else ()
        run = partial(runs.run_push, push)
        yield Stage(f"push {push.name}", f"Push {push.name}", acts, None, given, made.is_dir(), run)


def _unwritten(lab: LabFolder) -> int | None:
    """The act that `lab.yaml` waits for; raises InputError where it is written and refused."""
    document = read_yaml(lab.path / LAB_FILE)
    if isinstance(document.value, dict):
        for act, keys in ((PRINT, ("ruler",)), (FILL_IN, ("workspace", "tool"))):
            if any(document.value.get(key) is None for key in keys):
                return act
    lab.read_lab()
    return None


def _too_few(lab: LabFolder) -> int | None:
    """The act of the first set that has too few photos."""
    for name, act, fewest in zip(SETS, (LENS, ROBOT, TABLE), _FEWEST, strict=True):
        if len(lab.pictures(name)) < fewest:
            return act
    return None


def _there(*paths: Path) -> tuple[Path, ...]:
    return tuple(path for path in paths if path.is_file())


def _below(folder: Path) -> tuple[Path, ...]:
    """Files in a folder and those below it, but for hidden ones."""
    found = sorted(folder.rglob("*"))
    return tuple(one for one in found if one.is_file() and not any(p[0] == "." for p in one.relative_to(folder).parts))


def _masks(static: Path, frames: Sequence[Frame]) -> tuple[Path, ...]:
    return (*_pictures(static / "masks"), *(frame.mask_path for frame in frames if frame.mask_path is not None))


def _pusher(lab: LabFolder) -> tuple[Path, ...]:
    """File of the pusher's mesh that `capture.yaml` names."""
    mesh = load_unfinished(lab.capture).pusher.mesh_path if lab.scene.is_file() else None
    return () if mesh is None else _there(mesh)


def _is_cut_out(static: Path, frame: Frame) -> bool:
    """Flag: an image has a mask or, as its header says, alpha."""
    if frame.mask_path is not None or find_mask(static, frame.image_path, required=False):
        return True
    with opened_picture(frame.image_path) as picture:
        return picture.mode in ("RGBA", "LA", "PA")


def _pictures(folder: Path) -> tuple[Path, ...]:
    return tuple(path for path in _below(folder) if is_picture(path))


def _scene(lab: LabFolder) -> Given:
    """Input `capture.yaml` without what stages write into it."""
    return f"{lab.scene.name} without {' and '.join(FOUND)} of the object", lab.read_scene(found=False)
