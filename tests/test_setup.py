# SPDX-License-Identifier: MIT
import importlib.util
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parent.parent
TEXT = "![A film](docs/a.gif) and [pages](docs/index.md), [paper](https://pinwm.github.io), [below](#links)"


@pytest.fixture(scope="module")
def index_readme():
    spec = importlib.util.spec_from_file_location("setup", ROOT / "setup.py")
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module.index_readme


def test_links_lead_to_the_repository(index_readme):
    assert index_readme(TEXT, "https://example.org/o/p/") == (
        "![A film](https://example.org/o/p/raw/main/docs/a.gif) and "
        "[pages](https://example.org/o/p/blob/main/docs/index.md), "
        "[paper](https://pinwm.github.io), [below](#links)"
    )


def test_without_a_repository_no_link_is_broken(index_readme):
    assert index_readme(TEXT, "") == " and pages, [paper](https://pinwm.github.io), [below](#links)"
