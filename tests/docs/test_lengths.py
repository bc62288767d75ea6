# SPDX-License-Identifier: MIT
import pytest

from tests.docs.pages import DOCS, NOTEBOOKS, PAGES, ROOT, content, markdown_cells, name_of, sentences, words

LONGEST_PAGE, LONGEST_README = 200, 120  # lines
LONGEST_SENTENCE = 30  # words
# Pages of the site. The flat pages in docs/ itself are not: each is to become a page of a folder.
SITE = [path for path in PAGES if path.is_relative_to(DOCS) and (path.parent != DOCS or path.name == "index.md")]
PLAIN = [ROOT / "README.md", *(path for path in SITE if path.parent.name in ("how-to", "tutorials"))]


def too_long(text: str) -> list[str]:
    """Sentences of Markdown with too many words."""
    return [f"{words(one)} words: {one}" for one in sentences(text) if words(one) > LONGEST_SENTENCE]


def test_the_readme_is_short():
    assert len((ROOT / "README.md").read_text(encoding="utf-8").splitlines()) <= LONGEST_README


@pytest.mark.parametrize("page", SITE, ids=name_of)
def test_a_page_is_short(page):
    lines = page.read_text(encoding="utf-8").splitlines()
    assert len([line for line in lines if not line.startswith("|")]) <= LONGEST_PAGE


@pytest.mark.parametrize("page", PLAIN, ids=name_of)
def test_sentences_of_a_page_are_short(page):
    assert too_long(page.read_text(encoding="utf-8")) == []


@pytest.mark.parametrize("notebook", NOTEBOOKS, ids=name_of)
def test_sentences_of_a_notebook_are_short(notebook):
    assert [one for cell in markdown_cells(notebook) for one in too_long(cell)] == []


TEXT = """# A heading

One sentence, e.g. this one. Another with 0.5 m of `code that is a word`! It names H. Xu and the
frame W. They go over two lines; see [a page. Or so](x.md#a-b).

- An item
- A second one. `Code` begins a third.

1. A step

    an indented block that belongs to the step.

| a table | is left out. Of all |
| --- | --- |

<!-- A comment. -->
```bash
left out. As well
```

    so is this. Too
"""


def test_text_is_split_into_sentences():
    assert sentences(TEXT) == [
        "A heading",
        "One sentence, e.g. this one.",
        "Another with 0.5 m of `code`!",
        "It names H. Xu and the frame W.",
        "They go over two lines; see a page.",
        "Or so.",
        "An item",
        "A second one.",
        "`code` begins a third.",
        "A step",
        "an indented block that belongs to the step.",
    ]
    assert [snippet.line for snippet in content(TEXT).snippets] == [17, 21]


def test_words_are_counted():
    assert words("A twin of 3 % – and a well-known one.") == 8
    assert too_long(" ".join(["word"] * 30) + ". " + " ".join(["Word"] * 31) + ".") == [
        "31 words: " + " ".join(["Word"] * 31) + "."
    ]
