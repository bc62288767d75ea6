"""The scenarios that ship with pinwm_drake, by their names."""

from pathlib import Path

from pinwm_drake.errors import InputError
from pinwm_drake.models import PACKAGE_NAME, model_names

_FOLDER, _SUFFIX = "scenarios/", ".scenario.yaml"


def shipped_scenarios() -> list[str]:
    """Their names, such as "push_t", sorted."""
    names = (name for name in model_names() if name.startswith(_FOLDER) and name.endswith(_SUFFIX))
    return [name.removeprefix(_FOLDER).removesuffix(_SUFFIX) for name in names]


def scenario_path(text: str) -> str:
    """What `load_scenario` takes for a scenario that a user names.

    Args:
        text: A scenario's file, the name of one that ships, or a `package://` URL.

    Raises:
        InputError: There is no such file, and none of that name.
    """
    if text in shipped_scenarios() and not Path(text).exists():
        return f"package://{PACKAGE_NAME}/{_FOLDER}{text}{_SUFFIX}"
    if "://" not in text and not Path(text).exists():
        raise InputError(text, allowed=f"a file, a twin's folder, or one of {', '.join(shipped_scenarios())}")
    return text
