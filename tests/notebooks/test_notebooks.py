# SPDX-License-Identifier: MIT
import os
import sys
from pathlib import Path

import matplotlib.font_manager
import nbformat
import psutil
import pytest
from jupyter_client.kernelspec import KernelSpec, KernelSpecManager
from jupyter_client.manager import AsyncKernelManager
from nbclient import NotebookClient

ROOT = Path(__file__).resolve().parents[2]
NOTEBOOKS = sorted((ROOT / "notebooks").glob("*.ipynb"))
LONGEST_CELL = 30  # lines
# Addresses that only this machine reaches.
LOOPBACK = {"127.0.0.1", "::1", "::ffff:127.0.0.1"}


class ThisPython(KernelSpecManager):
    # The kernel is this interpreter's, whatever kernels there are on the machine.
    def get_kernel_spec(self, kernel_name):
        argv = [sys.executable, "-m", "ipykernel_launcher", "-f", "{connection_file}"]
        return KernelSpec(argv=argv, display_name="Python 3", language="python")


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


@pytest.fixture
def folder(tmp_path, monkeypatch):
    """An empty working directory, with everything that Jupyter and its kernel leave behind beside it."""
    jupyter = ("IPYTHONDIR", "JUPYTER_CONFIG_DIR", "JUPYTER_DATA_DIR", "JUPYTER_RUNTIME_DIR")
    for name in (*jupyter, "TORCHINDUCTOR_CACHE_DIR", "TMPDIR"):
        (tmp_path / name).mkdir()
        monkeypatch.setenv(name, str(tmp_path / name))
    monkeypatch.setenv("PINWM_FAST", "1")
    # The checkout itself is tested, installed or not.
    monkeypatch.setenv("PYTHONPATH", os.pathsep.join([str(ROOT), os.environ.get("PYTHONPATH", "")]).rstrip(os.pathsep))
    # The kernel's own; "agg", which a machine without a display may have set, would show no figure.
    monkeypatch.delenv("MPLBACKEND", raising=False)
    # It would be seen that a browser was opened.
    monkeypatch.setenv("BROWSER", f"touch {tmp_path / 'browser'} %s")
    # Built once for each machine, with a warning.
    assert matplotlib.font_manager.fontManager.ttflist
    (tmp_path / "work").mkdir()
    return tmp_path / "work"


def execute(notebook, folder: Path) -> set[str]:
    """Runs a notebook in a kernel of its own; the addresses on which it could be reached."""
    reached = set()

    def watch(cell, cell_index, execute_reply):
        reached.update(listening(client.km.provisioner.pid))

    client = NotebookClient(
        notebook,
        km=AsyncKernelManager(kernel_spec_manager=ThisPython()),
        timeout=600,
        resources={"metadata": {"path": str(folder)}},
        on_cell_executed=watch,
    )
    # Where ipykernel sees this variable, it leaves what is not written by Python out of the cells' outputs.
    env = {name: value for name, value in os.environ.items() if name != "PYTEST_CURRENT_TEST"}
    client.execute(cleanup_kc=True, env=env)  # raises CellExecutionError where a cell fails
    return reached


@pytest.mark.parametrize("path", NOTEBOOKS, ids=lambda path: path.stem)
def test_notebook_runs(path, folder):
    notebook = nbformat.read(path, as_version=4)
    reached = execute(notebook, folder)
    cells = [cell for cell in notebook.cells if cell.cell_type == "code"]
    outputs = [output for cell in cells for output in cell.outputs]
    assert text_of(outputs, "stderr") == ""
    assert "127.0.0.1" in reached  # the kernel itself, or nothing was seen
    assert reached <= LOOPBACK
    # There is something to see, and the last cell's own checks were made.
    assert any("image/png" in output.get("data", {}) for output in outputs)
    assert "assert " in cells[-1].source
    assert text_of(cells[-1].outputs, "stdout").strip() == "all checks hold"
    assert [entry.name for entry in folder.iterdir()] == ["out"]
    assert not list((folder.parent / "TMPDIR").iterdir())
    assert not (folder.parent / "browser").exists()


def test_what_must_not_be_would_be_seen(folder):
    source = """import os, socket, warnings, webbrowser
warnings.warn("from Python")
os.write(2, b"not from Python")
everywhere = socket.create_server(("0.0.0.0", 0))
webbrowser.open("about:blank")"""
    notebook = nbformat.v4.new_notebook(cells=[nbformat.v4.new_code_cell(source)])
    assert "0.0.0.0" in execute(notebook, folder)
    words = text_of(notebook.cells[0].outputs, "stderr")
    assert "UserWarning: from Python" in words
    assert "not from Python" in words
    assert (folder.parent / "browser").exists()


def test_there_are_notebooks():
    assert len(NOTEBOOKS) == 6


@pytest.mark.parametrize("path", NOTEBOOKS, ids=lambda path: path.stem)
def test_notebook_is_committed_clean(path):
    notebook = nbformat.read(path, as_version=4)
    nbformat.validate(notebook)
    assert notebook.metadata.kernelspec == {"display_name": "Python 3", "language": "python", "name": "python3"}
    assert set(notebook.metadata) == {"kernelspec", "language_info"}
    for cell in notebook.cells:
        assert len(cell.source.splitlines()) < LONGEST_CELL, cell.source
        assert not cell.metadata
        if cell.cell_type == "code":
            assert (cell.outputs, cell.execution_count) == ([], None)
    # A tutorial begins with words.
    assert notebook.cells[0].cell_type == "markdown"
    assert notebook.cells[0].source.startswith("# ")
