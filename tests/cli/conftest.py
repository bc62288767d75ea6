import sys
from collections.abc import Callable

import pytest

from pinwm_drake.cli import main


@pytest.fixture
def pinwm(monkeypatch, capsys) -> Callable[..., tuple[int, str, str]]:
    """Runs `pinwm` in this process: arguments in; exit code, output and error output back."""

    def run(*arguments: str) -> tuple[int, str, str]:
        monkeypatch.setattr(sys, "argv", ["pinwm", *arguments])
        try:
            main()
            code = 0
        except SystemExit as end:
            code = end.code or 0
        return code, *capsys.readouterr()

    return run
