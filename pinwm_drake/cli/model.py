# SPDX-License-Identifier: MIT
"""`pinwm model`: a twin as SDFormat."""

from pinwm_drake.cli.console import say
from pinwm_drake.experiments.requests.twins import ModelRequest


def model(request: ModelRequest) -> None:
    """Write a twin as SDFormat models, which Drake's Parser loads."""
    from pinwm_drake.systems.sdf.twin import write_twin_model
    from pinwm_drake.twin.read import load_twin

    for path in write_twin_model(load_twin(request.twin), request.out):
        say(f"wrote {path}")
