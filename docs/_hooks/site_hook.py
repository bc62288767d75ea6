# SPDX-License-Identifier: MIT
"""Hook of MkDocs: makes the reference pages, brings in pages from outside docs/, and mends links between them."""

import os
import re
import sys
from pathlib import Path
from typing import Any

from api_pages import api_pages
from mkdocs.plugins import CombinedEvent, event_priority
from mkdocs.structure.files import File, Files
from places import ROOT, brought, linked, with_links

sys.path.insert(0, str(ROOT))  # the checkout itself is described, installed or not

from cli_pages import cli_pages

_REPOSITORY = os.environ.get("PINWM_REPOSITORY", "")  # as for setup.py
# nbconvert's loader of diagrams from the network; the notebooks have none.
_REMOTE = re.compile(r"<script[^>]*>(?:(?!</script>).)*https://cdnjs(?:(?!</script>).)*</script>", re.DOTALL)
_HREF = re.compile(r'(<a [^>]*href=")([^"]+)(")')


@event_priority(100)
def _add_files(files: Files, *, config: Any) -> Files:
    """Add the generated pages and those from outside docs/, before other plugins look at the files."""
    for source, place in brought().items():
        files.append(File.generated(config, place, abs_src_path=str(ROOT / source)))
    for place, text in {**api_pages(ROOT), **cli_pages()}.items():
        files.append(File.generated(config, place, content=text))
    config.nav = _with_folders(config.nav, sorted(file.src_uri for file in files if _is_page(file)))
    return files


@event_priority(-100)
def _keep_notebooks(files: Files, *, config: Any) -> Files:
    """Tell mkdocs-jupyter's files where they are, which it forgets of those from outside docs/."""
    for file in files:
        if isinstance(inner := vars(file).get("file"), File):
            file.abs_src_path = inner.abs_src_path
    return files


on_files = CombinedEvent(_add_files, _keep_notebooks)


def on_page_markdown(markdown: str, *, page: Any, config: Any, files: Files) -> str:
    """Lead the links of a page to pages of the site, to the repository, or make text of them."""
    source = _source(page.file)
    return markdown if source is None else with_links(markdown, source, page.file.src_uri, _shown(files), _REPOSITORY)


def on_page_content(html: str, *, page: Any, config: Any, files: Files) -> str:
    """Lead the links of a notebook to pages of the site; those of Markdown have been mended before."""
    source = _source(page.file)
    if source is None or not source.endswith(".ipynb"):
        return html

    def link(found: re.Match[str]) -> str:
        leads = linked(found[2], source, page.file.src_uri, _shown(files), _REPOSITORY)
        path, mark, anchor = (leads or "").partition("#")
        target = files.get_file_from_path(os.path.normpath(os.path.join(os.path.dirname(page.file.src_uri), path)))
        if path and target is not None:
            leads = target.url_relative_to(page.file) + mark + anchor
        return f"{found[1]}{leads or '#'}{found[3]}"

    return _HREF.sub(link, _REMOTE.sub("", html))


def _is_page(file: File) -> bool:
    return file.src_uri.endswith((".md", ".ipynb")) and not file.inclusion.is_excluded()


def _source(file: File) -> str | None:
    """Return the path in the repository of a page's file; None for one that is generated."""
    path = file.abs_src_path
    return Path(path).relative_to(ROOT).as_posix() if path and Path(path).is_relative_to(ROOT) else None


def _shown(files: Files) -> Any:
    def shown(place: str) -> bool:
        file = files.get_file_from_path(place)
        return file is not None and not file.inclusion.is_excluded()

    return shown


def _with_folders(nav: Any, pages: list[str]) -> Any:
    """Return a navigation in which an entry with a slash at its end is the pages of a folder not named elsewhere."""
    named = set(_leaves(nav))

    def filled(entry: Any) -> list[Any]:
        if isinstance(entry, dict):
            return [
                {title: [one for part in inner for one in filled(part)] if isinstance(inner, list) else inner}
                for title, inner in entry.items()
            ]
        if not entry.endswith("/"):
            return [entry]
        rest = [page for page in pages if page.startswith(entry) and page not in named and not _deeper(page, entry)]
        return sorted(rest, key=lambda page: _order(page, entry))

    def _deeper(page: str, entry: str) -> bool:
        return any(other != entry and other.startswith(entry) and page.startswith(other) for other in named)

    return [one for entry in nav for one in filled(entry)]


def _order(page: str, folder: str) -> tuple[Any, ...]:
    """Return a key by which pages are sorted: the index first, a package before those in it, the last day first."""
    stem = page.removeprefix(folder).rpartition(".")[0]
    day = re.match(r"(\d{4})-(\d\d)-(\d\d)", stem)
    first = 0 if stem == "index" else 1 if stem == "pinwm_drake" else 2
    newest = tuple(-int(part) for part in day.groups()) if day else ()
    return first, newest, stem.split(".")


def _leaves(nav: Any) -> list[str]:
    if isinstance(nav, list):
        return [leaf for entry in nav for leaf in _leaves(entry)]
    if isinstance(nav, dict):
        return [leaf for entry in nav.values() for leaf in _leaves(entry)]
    return [nav]
