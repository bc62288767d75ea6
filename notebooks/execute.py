# SPDX-License-Identifier: MIT
"""Execute the notebooks and store them with their outputs: `make notebooks`, or `python notebooks/execute.py 01`."""

import os
import sys
import tempfile
from collections.abc import Callable
from pathlib import Path

import nbformat
from jupyter_client.kernelspec import KernelSpec, KernelSpecManager
from jupyter_client.manager import AsyncKernelManager
from nbclient import NotebookClient

ROOT = Path(__file__).resolve().parent
_WIDGET = "application/vnd.jupyter.widget-view+json"  # of no use without the kernel that made it


class ThisPython(KernelSpecManager):
    """Finds one kernel: this interpreter's, whatever kernels there are on the machine."""

    def get_kernel_spec(self, kernel_name: str) -> KernelSpec:
        """Return the specification of the kernel."""
        argv = [sys.executable, "-m", "ipykernel_launcher", "-f", "{connection_file}"]
        return KernelSpec(argv=argv, display_name="Python 3", language="python")


def execute(
    notebook: nbformat.NotebookNode, folder: Path, watch: Callable[[int], None] = lambda process: None
) -> nbformat.NotebookNode:
    """Run a notebook in a kernel of its own, and leave out of it what another run would have otherwise.

    Args:
        notebook: The notebook, changed in place.
        folder: Working directory of the kernel.
        watch: Called with the kernel's process after each cell.

    Raises:
        CellExecutionError: A cell failed.
    """
    client = NotebookClient(
        notebook,
        km=AsyncKernelManager(kernel_spec_manager=ThisPython()),
        timeout=600,
        record_timing=False,
        coalesce_streams=True,
        resources={"metadata": {"path": str(folder)}},
        on_cell_executed=lambda cell, cell_index, execute_reply: watch(client.km.provisioner.pid),
    )
    # The package of this checkout. Where ipykernel sees the other variable, it leaves what is not written by Python out
    # of the outputs; "agg" would show no figure.
    env = {name: value for name, value in os.environ.items() if name not in ("PYTEST_CURRENT_TEST", "MPLBACKEND")}
    env["PYTHONPATH"] = os.pathsep.join(filter(None, [str(ROOT.parent), os.environ.get("PYTHONPATH")]))
    client.execute(cleanup_kc=True, env=env)
    notebook.metadata = {
        "kernelspec": {"display_name": "Python 3", "language": "python", "name": "python3"},
        "language_info": {"name": "python"},
    }
    for cell in notebook.cells:
        cell.metadata = {}
        if cell.cell_type == "code":
            cell.outputs = [output for output in cell.outputs if _WIDGET not in output.get("data", {})]
    return notebook


def main(names: list[str]) -> None:
    """Execute and store notebooks by the beginnings of their names; all of them without a name."""
    for path in sorted(ROOT.glob("*.ipynb")):
        if names and not path.name.startswith(tuple(names)):
            continue
        notebook = nbformat.read(path, as_version=4)
        with tempfile.TemporaryDirectory() as folder:
            execute(notebook, Path(folder))
        nbformat.write(notebook, path)
        sys.stdout.write(f"{path.name}: {path.stat().st_size / 1e3:.0f} kB\n")


if __name__ == "__main__":
    main(sys.argv[1:])
