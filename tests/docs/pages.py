# SPDX-License-Identifier: MIT
"""Pages that people read, and what stands on them: prose, tables, headings, links and snippets."""

import importlib.util
import re
import sys
from dataclasses import dataclass
from pathlib import Path
from types import ModuleType

import nbformat

ROOT = Path(__file__).resolve().parents[2]
DOCS = ROOT / "docs"
PAGES = [
    *(ROOT / name for name in ("README.md", "CONTRIBUTING.md", "CHANGELOG.md", "benchmarks/README.md")),
    *sorted(path for path in DOCS.rglob("*.md") if "_hooks" not in path.parts),
]
NOTEBOOKS = sorted((ROOT / "notebooks").glob("*.ipynb"))

_FENCE = re.compile(r"^(?P<indent> *)(?P<marks>```+|~~~+) *(?P<language>[\w+-]*)[^\n]*$")
_MARK = re.compile(r"<!-- *snippet: *(\S+) *-->")
_COMMENT = re.compile(r"<!--.*?-->", re.DOTALL)
# An end of a sentence: a mark, maybe a closing quote or bracket, and the beginning of another one.
_END = re.compile(r"(?<=[.!?…])[\"')\]*_]*\s+(?=[\"'(\[*_`]*[A-ZÀ-ÖØ-ÞΑ-Ω0-9`])")
_ABBREVIATIONS = (
    "e.g.",
    "i.e.",
    "vs.",
    "cf.",
    "etc.",
    "approx.",
    "et al.",
    "resp.",
    "Fig.",
    "Eq.",
    "Sec.",
    "No.",
    "ca.",
)
# A letter of a name, such as H. Xu; those of frames end a sentence.
_INITIAL = re.compile(r"\b[ABD-NQ-VX-Z]\.$")


def name_of(path: Path) -> str:
    """Return the path of a page in the repository."""
    return path.relative_to(ROOT).as_posix()


@dataclass(frozen=True)
class Snippet:
    """Block of code on a page: its first line (from 1), language, mark in the line above it, and text."""

    line: int
    language: str
    mark: str
    text: str


@dataclass(frozen=True)
class Content:
    """Lines of a page apart: prose, and snippets; indented blocks are snippets of no language."""

    prose: list[str]
    snippets: list[Snippet]


def content(text: str) -> Content:
    """Separate the prose of Markdown from its snippets; a line of a snippet is an empty line of prose."""
    prose: list[str] = []
    snippets: list[Snippet] = []
    lines, k, mark = text.splitlines(), 0, ""
    while k < len(lines):
        line = lines[k]
        fence = _FENCE.match(line)
        if fence:
            end = next((n for n in range(k + 1, len(lines)) if lines[n].strip() == fence["marks"]), len(lines))
            block = [one.removeprefix(fence["indent"]) for one in lines[k + 1 : end]]
            snippets.append(Snippet(k + 1, fence["language"], mark, "\n".join(block) + "\n"))
            prose += [""] * (end + 1 - k)
            k, mark = end + 1, ""
            continue
        above = next((one for one in reversed(prose) if one.strip()), "")
        after_blank = not prose or not prose[-1].strip()
        if line.startswith("    ") and line.strip() and after_blank and not re.match(r"\s*([-*+]|\d+\.) ", above):
            end = k
            while end < len(lines) and (lines[end].startswith("    ") or not lines[end].strip()):
                end += 1
            snippets.append(Snippet(k + 1, "", mark, "\n".join(one[4:] for one in lines[k:end]) + "\n"))
            prose += [""] * (end - k)
            k, mark = end, ""
            continue
        found = _MARK.search(line)
        if found:
            mark = found[1]
        elif line.strip():
            mark = ""
        prose.append(line)
        k += 1
    return Content(prose[: len(lines)], snippets)


def sentences(text: str) -> list[str]:
    """Return the sentences of Markdown: of paragraphs, items of lists and headings; not of tables and code."""
    blocks: list[str] = []
    begin = True
    for line in _COMMENT.sub("", "\n".join(content(text).prose)).splitlines():
        bare = line.strip()
        if not bare or bare.startswith(("|", "<", "![", "---", "===")) or re.match(r"^\[[^\]]+\]:", bare):
            begin = True
            continue
        item = re.match(r"([-*+]|\d+[.)]|>+|#{1,6})\s+(.*)", bare)
        if item:
            bare = re.sub(r"^\[[ x]\]\s+", "", item[2])
        if begin or (item and not line.startswith(">")):
            blocks.append(bare)
        else:
            blocks[-1] += " " + bare
        begin = line.startswith("#")
    return [sentence for block in blocks for sentence in _split(plain(block))]


def plain(text: str) -> str:
    """Return text without Markdown: pictures and addresses of links go, and code is one word."""
    text = re.sub(r"!\[[^\]]*\]\([^)]*\)", "", text)
    text = re.sub(r"`[^`]+`", "`code`", text)
    text = re.sub(r"\[((?:[^\[\]]|\[[^\[\]]*\])*)\]\([^)]*\)", r"\1", text)
    text = re.sub(r"<https?://[^>]*>|https?://\S+", "link", text)
    text = re.sub(r"</?\w[^>]*>", "", text)
    return re.sub(r"[*_]{1,2}(?=\S)|(?<=\S)[*_]{1,2}", "", text)


def _split(text: str) -> list[str]:
    parts: list[str] = []
    for part in _END.split(text):
        if parts and (parts[-1].endswith(_ABBREVIATIONS) or _INITIAL.search(parts[-1])):
            parts[-1] += " " + part
        elif part.strip():
            parts.append(part.strip())
    return parts


def words(sentence: str) -> int:
    """Return the number of words of a sentence; signs alone are none."""
    return sum(any(letter.isalnum() for letter in word) for word in sentence.split())


def anchors(text: str) -> set[str]:
    """Return the anchors of Markdown's headings, as GitHub and the site give them."""
    found: set[str] = set()
    for line in content(text).prose:
        heading = re.match(r"^#{1,6} +(.*?)(?: +\{#([\w-]+)\})?$", line)
        if not heading:
            continue
        words_of_it = re.sub(r"\[([^\]]*)\]\([^)]*\)", r"\1", heading[1]).lower().strip()
        slug = heading[2] or re.sub(r"[^\w\- ]", "", words_of_it).replace(" ", "-")
        number = 1
        while slug in found:
            slug, number = f"{slug.removesuffix(f'-{number - 1}')}-{number}", number + 1
        found.add(slug)
    return found


def markdown_cells(path: Path) -> list[str]:
    """Return the text of a notebook's Markdown cells."""
    return [cell.source for cell in nbformat.read(path, as_version=4).cells if cell.cell_type == "markdown"]


def hook(name: str) -> ModuleType:
    """Return a module of docs/_hooks."""
    if name not in sys.modules:
        spec = importlib.util.spec_from_file_location(name, DOCS / "_hooks" / f"{name}.py")
        assert spec is not None
        assert spec.loader is not None
        sys.modules[name] = importlib.util.module_from_spec(spec)
        spec.loader.exec_module(sys.modules[name])
    return sys.modules[name]
