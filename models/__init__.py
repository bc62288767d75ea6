# SPDX-License-Identifier: MIT
"""The models that ship with pinwm_drake, reached by name or by package://pinwm_models/ URL.

The folder is a ROS-style package (see package.xml): Drake finds it with
`parser.package_map().AddPackageXml(str(model_path("package.xml")))`.

    t_block/t_block.obj   bar 100 x 40 mm, stem 40 x 100 mm, 50 mm thick
    large_t/large_t.obj   the same, 1.4 times as large
    cube/cube.obj         60 mm along each side
    mug/mug.obj           hollow, 80 mm long, 80 mm across, 4 mm wall, base at -z
    mug_handle/...        the same with a handle towards x, 28 mm wide

Meshes are watertight, in metres, with the origin at the centre of mass. Beside each NAME.obj stand NAME_visual.obj:
its surface in colours that tell which way it has turned (see paint.py); NAME.sdf: a body of 1 kg for hydroelastic
contact, with NAME_contact.obj for the pusher and NAME_support.vtk for the floor; and NAME_point.sdf: the same for point
contact, with the meshes in pieces/.

    floor/floor.sdf       top at z = 0
    pusher/KIND.sdf       sphere, capsule or cylinder of 20 mm on three driven slides along x, y and z of the world
    policies/NAME/        bundles of trained policies, which `policy_path` finds
    twins/NAME/           twins that `pinwm identify` made, which `twin_path` finds
    captures/NAME/        captures, which `capture_path` finds

In SDFormat every pair has friction 0.1. `systems/sdf/shipped.py` writes these files.

    arm/iiwa14.sdf        a KUKA LBR iiwa 14 with a rod, of cylinders; the numbers' sources stand in the file
    arm/panda.sdf         a Franka Emika Panda with a rod, likewise
"""

import difflib
from dataclasses import dataclass
from pathlib import Path

from pinwm_drake.errors import InputError

PACKAGE_NAME = "pinwm_models"
_ROOT = Path(__file__).resolve().parent
_SCHEME, _POLICIES, _TWINS = "package://", "policies", "twins"
SCENARIO_SUFFIX = ".scenario.yaml"

OBJECT_NAMES = ("t_block", "large_t", "cube", "mug", "mug_handle")
PUSHER_NAMES = ("sphere", "capsule", "cylinder")
_SUFFIXES = {".mtl", ".obj", ".sdf", ".vtk", ".xml", ".yaml"}


@dataclass(frozen=True)
class ObjectModel:
    """The files of an object.

    Attributes:
        name: One of `OBJECT_NAMES`.
        mesh_path: Watertight mesh, m, origin at the centre of mass.
        visual_path: The same surface in colours; not one closed mesh.
        sdf_path: SDFormat for hydroelastic contact.
        point_sdf_path: SDFormat for point contact.
    """

    name: str
    mesh_path: Path
    visual_path: Path
    sdf_path: Path
    point_sdf_path: Path


def object_model(name: str) -> ObjectModel:
    """Return the files of an object that ships with pinwm_drake.

    Args:
        name: One of `OBJECT_NAMES`.

    Raises:
        InputError: When there is no such object.
    """
    if name not in OBJECT_NAMES:
        raise InputError(_ROOT, value=f"object {name!r}", allowed=", ".join(OBJECT_NAMES))
    ends = (".obj", "_visual.obj", ".sdf", "_point.sdf")
    return ObjectModel(name, *(model_path(f"{name}/{name}{end}") for end in ends))


def shipped_policies() -> list[str]:
    """Names of the policies that ship with pinwm_drake, sorted."""
    return _folders(_POLICIES)


def shipped_twins() -> list[str]:
    """Names of the twins that ship with pinwm_drake, sorted."""
    return _folders(_TWINS)


def _folders(name: str) -> list[str]:
    folder = _ROOT / name
    return sorted(path.name for path in folder.iterdir() if path.is_dir()) if folder.is_dir() else []


def shipped_scenarios() -> list[str]:
    """Names of the scenarios that ship with pinwm_drake, such as "push_t", sorted."""
    return sorted(path.name.removesuffix(SCENARIO_SUFFIX) for path in (_ROOT / "scenarios").glob(f"*{SCENARIO_SUFFIX}"))


def policy_path(text: str) -> Path:
    """Return the folder of a policy that a user names.

    Args:
        text: A folder, or the name of a policy that ships; a folder of that name goes first.

    Raises:
        InputError: There is no such folder, and no policy of that name.
    """
    path = _named(_POLICIES, text)
    if not path.is_dir():
        allowed = f"a folder, or one of {', '.join(shipped_policies()) or 'none that ship'}"
        raise InputError(text, value="no such policy", allowed=allowed)
    return path


def twin_path(text: str | Path) -> Path:
    """Return the folder of a twin: that of a name that ships, such as "t_block", else the path as it is, unchecked."""
    return _named(_TWINS, text)


def capture_path(text: str | Path) -> Path:
    """Return the folder of a capture; see `twin_path`."""
    return _named("captures", text)


def _named(folder: str, text: str | Path) -> Path:
    """Path of a folder that ships, where its name is given and nothing beside the user has that name."""
    ships = _ROOT / folder / text
    return ships if not Path(text).exists() and ships.parent == _ROOT / folder and ships.is_dir() else Path(text)


def model_names() -> list[str]:
    """Return the names that `model_path` takes, sorted, with forward slashes."""
    files = (path for path in _ROOT.rglob("*") if path.is_file() and path.suffix in _SUFFIXES)
    return sorted(path.relative_to(_ROOT).as_posix() for path in files)


def model_path(name: str) -> Path:
    """Path of a model file, in a checkout as in an installed package.

    Args:
        name: Path inside the package with forward slashes, such as "t_block/t_block.obj".

    Returns:
        Absolute path of an existing file.

    Raises:
        InputError: When there is no such model.
    """
    path = _ROOT / name
    if path.suffix not in _SUFFIXES or {"", ".", ".."} & set(name.split("/")) or not path.is_file():
        names = model_names()
        close = difflib.get_close_matches(name, names, n=1)
        hint = f" (did you mean {close[0]}?)" if close else ""
        listed = ", ".join(each for each in names if "/pieces/" not in each)
        raise InputError(_ROOT, value=f"model name {name!r}", allowed=listed + hint)
    return path


def resolve(url: str) -> Path:
    """Turn a mesh reference of a file into a path.

    Args:
        url: "package://pinwm_models/...", or a plain path, which is returned as it is.

    Returns:
        Path of an existing model file, or the plain path, unchecked.

    Raises:
        InputError: When the URL names another package, or a model that is not there.
    """
    if not url.startswith(_SCHEME):
        return Path(url)
    package, _, name = url.removeprefix(_SCHEME).partition("/")
    if package != PACKAGE_NAME:
        raise InputError(url, value=f"package {package!r}", allowed=f"{_SCHEME}{PACKAGE_NAME}/...")
    return model_path(name)
