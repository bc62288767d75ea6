"""What `pinwm model` does."""

from pathlib import Path

from rich.console import Console

from pinwm_drake.systems.sdf.twin import write_twin_model
from pinwm_drake.twin import read_twin


def run_model(twin: Path, out: Path) -> None:
    """Writes the models of a twin, and says where.

    Args:
        twin: The twin's folder.
        out: Where to; made if need be.

    Raises:
        PinwmError: The twin cannot be read, or a file cannot be written.
    """
    found = read_twin(twin)
    console = Console()
    for path in write_twin_model(found, out):
        console.print(f"wrote {path}", highlight=False, soft_wrap=True, markup=False)
