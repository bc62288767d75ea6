"""Parts of a page in HTML: escaped text, tables, pictures."""

import html
import re
from collections.abc import Iterable, Mapping, Sequence
from pathlib import Path
from typing import Any

_TEMPLATE = Path(__file__).with_name("twin_report.html")


def fill_template(parts: Mapping[str, str]) -> str:
    """Page of the report with its places filled, each once; text that is filled in is not searched again."""
    return re.sub(r"\{\{(\w+)\}\}", lambda match: parts[match[1]], _TEMPLATE.read_text(encoding="utf-8"))


def text(value: object) -> str:
    """Text of any value, escaped for a page."""
    # A lone surrogate, as a path of bytes that are no UTF-8 has it, cannot be written.
    return html.escape(str(value).encode("utf-8", "replace").decode("utf-8"))


def section(title: str, *contents: str) -> str:
    """Card with a heading; contents are HTML. Empty text where they are empty."""
    inside = "\n".join(part for part in contents if part)
    return f"<section>\n<h2>{text(title)}</h2>\n{inside}\n</section>" if inside else ""


def paragraph(words: str, kind: str = "caption") -> str:
    """Paragraph of a page, with a class."""
    return f'<p class="{kind}">{text(words)}</p>'


def figure(uri: str, words: str, *, narrow: bool = False) -> str:
    """Figure of a page with its caption."""
    kind = ' class="narrow"' if narrow else ""
    return f'<figure{kind}><img src="{uri}" alt="{text(words)}"><figcaption>{text(words)}</figcaption></figure>'


def table(header: Sequence[tuple[str, str]], rows: Iterable[Sequence[str]]) -> str:
    """Table of a page, in HTML.

    Args:
        header: For each column its heading and its class, which is that of its cells too.
        rows: HTML of the cells.
    """
    head = "".join(f'<th class="{kind}">{text(name)}</th>' for name, kind in header)
    kinds = [kind for _, kind in header]
    body = "\n".join(f"<tr>{_cells(row, kinds)}</tr>" for row in rows)
    return f'<div class="scroll"><table><thead><tr>{head}</tr></thead>\n<tbody>{body}</tbody></table></div>'


def _cells(row: Sequence[str], kinds: Sequence[str]) -> str:
    return "".join(f'<td class="{kind}">{cell}</td>' for cell, kind in zip(row, kinds, strict=True))


def tree(value: Any) -> str:
    """Tree of plain data: mappings as tables in tables, lists of values in one line."""
    if isinstance(value, Mapping) and value:
        rows = [_cells((text(key), tree(item)), ("key", "wide")) for key, item in value.items()]
        return f'<table class="tree">{"".join(f"<tr>{row}</tr>" for row in rows)}</table>'
    if isinstance(value, list) and any(isinstance(item, (Mapping, list)) for item in value):
        return tree({str(number): item for number, item in enumerate(value)})
    if isinstance(value, list):
        return ", ".join(tree(item) for item in value) or "none"
    if isinstance(value, Mapping) or value is None:
        return "none"
    if isinstance(value, bool):
        return "yes" if value else "no"
    return text(f"{value:.6g}" if isinstance(value, float) else value)
