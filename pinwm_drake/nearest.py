# SPDX-License-Identifier: MIT
"""The nearest name or path to one that an error refuses."""

import difflib
import re
from collections.abc import Sequence
from pathlib import Path

from pinwm_drake.errors import InputError, PinwmError

_ALLOWED = r"; allowed: (?P<allowed>.*)$"
# What is refused: `got word`, `got an unknown key "word" under theta`, `no episode 'word'`, or `got object = "word"`.
_REFUSED = (
    re.compile(r"got (?P<word>[\w.:/+ -]+)" + _ALLOWED),
    re.compile(r"(?:got|no)(?: [\w.\[\]]+| =)* (['\"])(?P<word>[\w.:/+ -]+)\1(?: under .*?)?" + _ALLOWED),
)
_MISSING = re.compile("(no|none) ", re.IGNORECASE)  # beginning of what is said of a path that is not there
_BETWEEN = re.compile(r",\s*(?:or\s+)?|\s+or\s+|:\s+|\s+of\s+|;\s*")
_WORD = re.compile(r"[\w./-]+")
_MOST_WORDS = 3  # of a name


def nearest(error: PinwmError) -> str:
    """Return the allowed name, or the path that is there, nearest to what an error refuses; "" where none is near."""
    message = str(error).replace("\n", " ")
    if isinstance(error, InputError) and _MISSING.match(str(error.value)) and not Path(error.path).exists():
        names = _near(Path(error.path).name, _words(error.allowed))
        if found := names or _near_path(Path(error.path)):
            return found
    refused = next(filter(None, (pattern.search(message) for pattern in _REFUSED)), None)
    if refused is None or not _is_name(refused["word"]):
        return ""
    word, allowed = refused["word"], refused["allowed"]
    several = [part for part in allowed.split(", ") if _is_name(part)] if " " in word else []
    return _near(word, _words(allowed) + several)


def _is_name(text: str) -> bool:
    """Whether a text of one to three words is a name, and no thing or event in words."""
    return len(text.split()) <= _MOST_WORDS and not text.startswith(("a ", "an ", "one ", "neither ", "no ", "not "))


def _words(allowed: str) -> list[str]:
    """Names of one word among the words that say what is allowed."""
    return [part for part in _BETWEEN.split(allowed) if _WORD.fullmatch(part)]


def _near(word: str, names: Sequence[str]) -> str:
    """Return the one of some names that is alike, or the only one that begins with a word; "" for none."""
    plain = {name.lower(): name for name in names if name != word}
    begins = [name for name in plain if len(word) > 1 and name.startswith(word.lower())]
    close = begins if len(begins) == 1 else difflib.get_close_matches(word.lower(), plain, n=1)
    return plain[close[0]] if close else ""


def _near_path(path: Path) -> str:
    """Return the path that is there and differs in one name only, as far as it goes; "" for none."""
    ancestor, rest = path, list[str]()
    while not ancestor.exists() and ancestor != ancestor.parent:
        rest.insert(0, ancestor.name)
        ancestor = ancestor.parent
    try:
        siblings = sorted(each.name for each in ancestor.iterdir()) if ancestor.is_dir() else []
    except OSError:
        return ""
    name = _near(rest[0], siblings) if rest else ""
    if not name:
        return ""
    whole = ancestor.joinpath(name, *rest[1:])
    return str(whole if whole.exists() else ancestor / name)
