# SPDX-License-Identifier: MIT
import ast
from pathlib import Path

import matplotlib.font_manager
import nbformat
import psutil
import pytest

from notebooks.execute import execute

ROOT = Path(__file__).resolve().parents[2]
NOTEBOOKS = sorted((ROOT / "notebooks").glob("*.ipynb"))
LONGEST_CELL = 30  # lines
MOST_IMPORTS = 5  # lines of a notebook
LARGEST = 700e3  # bytes of a stored notebook
# Addresses that only this machine reaches.
LOOPBACK = {"127.0.0.1", "::1", "::ffff:127.0.0.1"}


def listening(pid: int) -> set[str]:
    """The addresses on which a process and its children can be reached."""
    process = psutil.Process(pid)
    found = set()
    for one in [process, *process.children(recursive=True)]:
        connections = one.net_connections(kind="inet")
        found |= {entry.laddr.ip for entry in connections if entry.status == psutil.CONN_LISTEN}
    return found


def text_of(outputs, name):
    """What cells wrote to a stream."""
    return "".join(output["text"] for output in outputs if output["output_type"] == "stream" and output["name"] == name)


def code_of(notebook):
    return [cell for cell in notebook.cells if cell.cell_type == "code"]


def kinds(notebook):
    """Of each code cell, the streams and the kinds of data that it shows."""
    return [
        [output.get("name") or sorted(output.get("data", {})) for output in cell.outputs] for cell in code_of(notebook)
    ]


@pytest.fixture
def folder(tmp_path, monkeypatch):
    """An empty working directory, with everything that Jupyter and its kernel leave behind beside it."""
    jupyter = ("IPYTHONDIR", "JUPYTER_CONFIG_DIR", "JUPYTER_DATA_DIR", "JUPYTER_RUNTIME_DIR")
    for name in (*jupyter, "TORCHINDUCTOR_CACHE_DIR", "TMPDIR"):
        (tmp_path / name).mkdir()
        monkeypatch.setenv(name, str(tmp_path / name))
    # It would be seen that a browser was opened.
    monkeypatch.setenv("BROWSER", f"touch {tmp_path / 'browser'} %s")
    # Built once for each machine, with a warning.
    assert matplotlib.font_manager.fontManager.ttflist
    (tmp_path / "work").mkdir()
    return tmp_path / "work"


# Each takes half a minute of CPU.
@pytest.mark.nightly
@pytest.mark.parametrize("path", NOTEBOOKS, ids=lambda path: path.stem)
def test_notebook_runs_and_shows_what_is_stored(path, folder):
    stored, notebook = (nbformat.read(path, as_version=4) for _ in range(2))
    reached = set()
    execute(notebook, folder, lambda process: reached.update(listening(process)))
    outputs = [output for cell in code_of(notebook) for output in cell.outputs]
    assert text_of(outputs, "stderr") == ""
    assert "127.0.0.1" in reached  # the kernel itself, or nothing was seen
    assert reached <= LOOPBACK
    assert kinds(notebook) == kinds(stored)
    assert text_of(code_of(notebook)[-1].outputs, "stdout").strip() == "all checks hold"
    assert [entry.name for entry in folder.iterdir()] in ([], ["out"])
    assert not list((folder.parent / "TMPDIR").iterdir())
    assert not (folder.parent / "browser").exists()


def test_what_must_not_be_would_be_seen(folder):
    source = """import os, socket, warnings, webbrowser
warnings.warn("from Python")
os.write(2, b"not from Python")
everywhere = socket.create_server(("0.0.0.0", 0))
webbrowser.open("about:blank")"""
    notebook = nbformat.v4.new_notebook(cells=[nbformat.v4.new_code_cell(source)])
    reached = set()
    execute(notebook, folder, lambda process: reached.update(listening(process)))
    assert "0.0.0.0" in reached
    words = text_of(notebook.cells[0].outputs, "stderr")
    assert "UserWarning: from Python" in words
    assert "not from Python" in words
    assert (folder.parent / "browser").exists()


def test_what_is_stored_has_no_time_and_no_state_of_a_kernel(folder):
    source = "import ipywidgets\nprint(1)\nipywidgets.IntSlider()"
    notebook = nbformat.v4.new_notebook(cells=[nbformat.v4.new_code_cell(source)])
    execute(notebook, folder)
    assert set(notebook.metadata) == {"kernelspec", "language_info"}
    assert not notebook.cells[0].metadata
    assert kinds(notebook) == [["stdout"]]


def test_there_are_notebooks():
    assert len(NOTEBOOKS) == 6


@pytest.mark.parametrize("path", NOTEBOOKS, ids=lambda path: path.stem)
def test_notebook_is_stored_executed_and_small(path):
    notebook = nbformat.read(path, as_version=4)
    nbformat.validate(notebook)
    assert path.stat().st_size < LARGEST
    assert notebook.metadata.kernelspec == {"display_name": "Python 3", "language": "python", "name": "python3"}
    assert set(notebook.metadata) == {"kernelspec", "language_info"}
    assert [cell.id for cell in notebook.cells] == [f"cell-{k:02d}" for k in range(1, len(notebook.cells) + 1)]
    assert not any(cell.metadata for cell in notebook.cells)
    code = code_of(notebook)
    assert [cell.execution_count for cell in code] == list(range(1, len(code) + 1))
    outputs = [output for cell in code for output in cell.outputs]
    assert not [output for output in outputs if output.output_type == "error"]
    assert any({"image/png", "image/jpeg"} & set(output.get("data", {})) for output in outputs)
    assert "assert " in code[-1].source
    assert text_of(code[-1].outputs, "stdout") == "all checks hold\n"


@pytest.mark.parametrize("path", NOTEBOOKS, ids=lambda path: path.stem)
def test_notebook_is_short_to_read(path):
    notebook = nbformat.read(path, as_version=4)
    lines = [cell.source.splitlines() for cell in code_of(notebook)]
    assert max(map(len, lines)) < LONGEST_CELL
    trees = [ast.parse("\n".join(line for line in cell if not line.startswith("%"))) for cell in lines]
    imports = [[node for node in ast.walk(tree) if isinstance(node, ast.Import | ast.ImportFrom)] for tree in trees]
    assert sum(node.end_lineno - node.lineno + 1 for nodes in imports for node in nodes) <= MOST_IMPORTS
    assert not any(imports[1:])  # the first cell has them all
    assert "import pinwm_drake as pw" in lines[0]
    words = [cell.source for cell in notebook.cells]
    assert not [text for text in words if "FAST" in text]
    # The first cell says for whom it is and what they can do then.
    assert words[0].startswith("# ")
    assert "\nFor " in words[0]
    assert "After it you can" in " ".join(words[0].split())
