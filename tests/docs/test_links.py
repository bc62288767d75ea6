# SPDX-License-Identifier: MIT
import re

import pytest

from tests.docs.pages import NOTEBOOKS, PAGES, ROOT, anchors, content, hook, markdown_cells, name_of

_LINK = re.compile(r"\]\(((?!\w+:)[^()\s]+)\)")
# Pages that the site generates, by their path below docs/; their anchors are those of headings and of the API.
GENERATED = {**hook("api_pages").api_pages(ROOT), **hook("cli_pages").cli_pages()}


def broken(text: str, folder, own_anchors: set[str]) -> list[str]:
    """Links of Markdown in a folder that lead nowhere."""
    found = []
    for target in _LINK.findall(re.sub(r"`[^`\n]+`", "", "\n".join(content(text).prose))):
        path, _, anchor = target.partition("#")
        if not path:
            known = own_anchors
        else:
            file = (folder / path).resolve()
            place = file.relative_to(ROOT).as_posix() if file.is_relative_to(ROOT) else ""
            made = GENERATED.get(place.removeprefix("docs/"))
            if made is None and not file.exists():
                found.append(target)
                continue
            if not anchor:
                continue
            known = anchors(made if made is not None else file.read_text(encoding="utf-8"))
        if anchor not in known:
            found.append(target)
    return found


@pytest.mark.parametrize("page", PAGES, ids=name_of)
def test_what_a_page_points_to_is_there(page):
    text = page.read_text(encoding="utf-8")
    assert broken(text, page.parent, anchors(text)) == []


@pytest.mark.parametrize("notebook", NOTEBOOKS, ids=name_of)
def test_what_a_notebook_points_to_is_there(notebook):
    text = "\n\n".join(markdown_cells(notebook))
    assert broken(text, notebook.parent, anchors(text)) == []


def test_a_broken_link_is_found(tmp_path):
    (tmp_path / "there.md").write_text("# Of a kind\n\n## Of a kind\n")
    text = "# Here\n\n[a](there.md) [b](there.md#of-a-kind-1) [c](gone.md) [d](there.md#gone) [e](#here) [f](#gone)\n"
    assert broken(text, tmp_path, anchors(text)) == ["gone.md", "there.md#gone", "#gone"]
