import os
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parent.parent


@pytest.fixture(scope="session")
def shared() -> Path:
    """The project's shared folder, beside the checkout; tests of released data skip where it is not."""
    folder = Path(os.environ.get("PINWM_SHARED", ROOT.parent / "shared"))
    if not (folder / "data").is_dir():
        pytest.skip(f"no {folder}/data on this machine")
    return folder
