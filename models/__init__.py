"""The models that ship with pinwm_drake, reached by name or by package://pinwm_models/ URL.

The folder is a ROS-style package (see package.xml): Drake finds it with
`parser.package_map().AddPackageXml(str(model_path("package.xml")))`.

    t_block/t_block.obj   bar 100 x 40 mm, stem 40 x 100 mm, 50 mm thick
    mug/mug.obj           hollow, 80 mm long, 80 mm across, 4 mm wall, base at -z

Meshes are watertight, in metres, with the origin at the centre of mass.
"""

import difflib
from pathlib import Path

from pinwm_drake.errors import InputError

PACKAGE_NAME = "pinwm_models"
_ROOT = Path(__file__).resolve().parent
_SCHEME = "package://"


def model_names() -> list[str]:
    """The names that `model_path` takes, sorted, with forward slashes."""
    files = (path for path in _ROOT.rglob("*") if path.is_file() and path.suffix in {".obj", ".xml"})
    return sorted(path.relative_to(_ROOT).as_posix() for path in files)


def model_path(name: str) -> Path:
    """Finds a model file, in a checkout as in an installed package.

    Args:
        name: Path inside the package with forward slashes, such as "t_block/t_block.obj".

    Returns:
        Absolute path of an existing file.

    Raises:
        InputError: When there is no such model.
    """
    names = model_names()
    if name not in names:
        close = difflib.get_close_matches(name, names, n=1)
        hint = f" (did you mean {close[0]}?)" if close else ""
        raise InputError(_ROOT, value=f"model name {name!r}", allowed=", ".join(names) + hint)
    return _ROOT / name


def resolve(url: str) -> Path:
    """Turns a mesh reference of a file into a path.

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
