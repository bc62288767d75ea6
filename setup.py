# SPDX-License-Identifier: MIT
"""README for a package index, whose pages know no files beside it: links lead to the repository, or become text.

The address of the repository stands in the environment variable PINWM_REPOSITORY, such as
https://github.com/OWNER/pinwm_drake, when a distribution is built. Everything else stands in pyproject.toml.
"""

import os
import re
from pathlib import Path

from setuptools import setup


def index_readme(text: str, repository: str) -> str:
    """README with absolute links.

    Args:
        text: README.md.
        repository: Address of the repository; empty where there is none, which turns links to files into text and
            leaves pictures out.
    """

    def link(found: re.Match[str]) -> str:
        picture, words, target = found.groups()
        if "://" in target or target.startswith("#"):
            return found[0]
        if not repository:
            return "" if picture else words
        kind = "raw" if picture else "blob"
        return f"{picture}[{words}]({repository.rstrip('/')}/{kind}/main/{target})"

    return re.sub(r"(!?)\[([^\]]*)\]\(([^)\s]+)\)", link, text)


if __name__ == "__main__":
    readme = Path(__file__).with_name("README.md").read_text(encoding="utf-8")
    setup(
        long_description=index_readme(readme, os.environ.get("PINWM_REPOSITORY", "")),
        long_description_content_type="text/markdown",
    )
