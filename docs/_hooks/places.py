# SPDX-License-Identifier: MIT
"""Places of the site's pages: files of the repository that it shows, and links from one to another."""

import posixpath
import re
from collections.abc import Callable
from pathlib import Path, PurePosixPath

ROOT = Path(__file__).resolve().parents[2]
# Files outside docs/ that are pages or pictures of the site, as a pattern and the folder or page that they become.
BROUGHT = (
    ("notebooks/*.ipynb", "tutorials/"),
    ("benchmarks/README.md", "results/benchmarks.md"),
    ("benchmarks/*.png", "results/"),
    ("CHANGELOG.md", "changes.md"),
)
_LINK = re.compile(r"(?P<picture>!?)\[(?P<words>(?:[^\[\]]|\[[^\[\]]*\])*)\]\((?P<target>[^()\s]+)\)")
_CODE = re.compile(r"(^ *```.*?^ *```|`[^`\n]+`)", re.DOTALL | re.MULTILINE)


def brought() -> dict[str, str]:
    """Return the path in the site of each file from outside docs/, by its path in the repository."""
    found = {}
    for pattern, target in BROUGHT:
        for path in sorted(ROOT.glob(pattern)):
            found[path.relative_to(ROOT).as_posix()] = target + path.name if target.endswith("/") else target
    return found


def site_path(repository_path: str) -> str | None:
    """Return the path in the site of a file of the repository; None for one that the site does not show."""
    if repository_path.startswith("docs/"):
        return repository_path.removeprefix("docs/")
    if repository_path == "README.md":
        return "index.md"
    if repository_path == "CONTRIBUTING.md":
        return "contributing/index.md"
    return brought().get(repository_path)


def with_links(text: str, source: str, page: str, shown: Callable[[str], bool], repository: str) -> str:
    """Return Markdown whose links lead to pages of the site, to the repository, or become text.

    Args:
        text: Markdown, with links between files of the repository.
        source: Path of its file in the repository.
        page: Path of its page in the site.
        shown: Function that tells whether the site shows a path.
        repository: Address of the repository; empty where there is none, which turns links to its files into text.
    """

    def link(found: re.Match[str]) -> str:
        picture, words, target = found["picture"], found["words"], found["target"]
        leads = linked(target, source, page, shown, repository)
        if leads is not None:
            return f"{picture}[{words}]({leads})"
        name = PurePosixPath(target).name
        return "" if picture else words if name in words else f"{words} (`{name}`)"

    # Every second part is code, which stays as it is.
    parts = _CODE.split(text)
    return "".join(part if k % 2 else _LINK.sub(link, part) for k, part in enumerate(parts))


def linked(target: str, source: str, page: str, shown: Callable[[str], bool], repository: str) -> str | None:
    """Return the target of a link in the site; None where the site has none. Arguments as for `with_links`."""
    if re.match(r"\w+:", target) or target.startswith(("#", "/")):
        return target
    path, mark, anchor = target.partition("#")
    whole = posixpath.normpath(posixpath.join(posixpath.dirname(source), path))
    place = site_path(whole)
    if place is not None and shown(place):
        return posixpath.relpath(place, posixpath.dirname(page) or ".") + mark + anchor
    if not (ROOT / whole).exists():
        return target  # the build names the page whose link is broken
    return f"{repository.rstrip('/')}/blob/main/{whole}{mark}{anchor}" if repository else None
