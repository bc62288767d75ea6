# SPDX-License-Identifier: MIT
"""The whole site, built once."""

import ast
import os
import posixpath
import re
import subprocess
import sys

import pytest

from tests.docs.pages import NOTEBOOKS, ROOT, hook

pytestmark = pytest.mark.nightly


@pytest.fixture(scope="module")
def site(tmp_path_factory):
    """Folder of the site; a warning of its build fails."""
    folder = tmp_path_factory.mktemp("site")
    command = [sys.executable, "-m", "mkdocs", "build", "--strict", "--site-dir", str(folder)]
    environment = {**os.environ, "NO_MKDOCS_2_WARNING": "1"}
    done = subprocess.run(command, cwd=ROOT, env=environment, capture_output=True, text=True, check=False)
    warnings = [line for line in done.stderr.splitlines() if not line.startswith(("INFO", "DEBUG"))]
    assert done.returncode == 0, "\n".join(warnings)
    assert "WARNING" not in done.stderr
    return folder


@pytest.fixture(scope="module")
def pages(site):
    """Contents of the pages by their path."""
    return {path.relative_to(site).as_posix(): path.read_text(encoding="utf-8") for path in site.rglob("*.html")}


def test_nothing_is_loaded_from_the_network(pages):
    loaded = re.compile(
        r"""<(?:script|link|img|iframe|source|video)\b[^>]*?\b(?:src|href)=["']?(https?:)?//[^"'\s>]+"""
    )
    for place, page in pages.items():
        found = [match[0] for match in loaded.finditer(page) if 'rel="canonical"' not in match[0]]
        assert found == [], place
        assert "cdnjs." not in page, place


def test_data_of_the_results_is_left_out(site):
    assert not (site / "results/reproduce").exists()
    assert [path.name for path in site.rglob("*.json")] == ["search_index.json"]


def test_notebooks_are_tutorials(pages):
    assert {f"tutorials/{notebook.stem}.html" for notebook in NOTEBOOKS} <= set(pages)


def test_every_public_symbol_has_a_place_on_a_page_of_the_api(pages):
    api = "".join(page for place, page in pages.items() if place.startswith("reference/api/"))
    anchors = set(re.findall(r'id="(pinwm_drake[\w.]*)"', api))
    missing = []
    for modules in hook("api_pages").public_modules(ROOT).values():
        for module in modules:
            text = ROOT.joinpath(*module.split(".")).with_suffix(".py").read_text(encoding="utf-8")
            names = [node.name for node in ast.parse(text).body if isinstance(node, (ast.ClassDef, ast.FunctionDef))]
            missing += [f"{module}.{name}" for name in names if not name.startswith("_")]
    assert len(missing) > 500
    assert [name for name in missing if name not in anchors] == []


def test_links_within_the_site_lead_somewhere(site, pages):
    """Those of notebooks and of the API as well, which the build does not check."""
    anchors = {place: set(re.findall(r'\bid="([^"]+)"', page)) for place, page in pages.items()}
    files = {path.relative_to(site).as_posix() for path in site.rglob("*") if path.is_file()}
    broken = set()
    for place, page in pages.items():
        if place == "404.html":  # its links begin at the root of a server
            continue
        for target in re.findall(r'<a\b[^>]*\bhref="((?!\w+:)[^"]+)"', page):
            path, _, anchor = target.partition("#")
            whole = posixpath.normpath(posixpath.join(posixpath.dirname(place), path)) if path else place
            if whole not in files or (anchor and anchor not in anchors.get(whole, {anchor})):
                broken.add(f"{place}: {target}")
    assert broken == set()
