# SPDX-License-Identifier: MIT
"""`pinwm model`: a twin as SDFormat."""

from pinwm_drake.cli.console import say, stages_bar
from pinwm_drake.experiments.requests.twins import ModelRequest


def model(request: ModelRequest) -> None:
    """Write a twin as SDFormat models, which Drake's Parser loads."""
    from pinwm_drake.geometry.primitive import acting_words
    from pinwm_drake.systems.sdf.twin import write_twin_model
    from pinwm_drake.twin.read import load_twin

    twin = load_twin(request.twin)
    with stages_bar(transient=True) as show:
        show("writing", 0.0, "meshes of the contact; a new mesh is cut into pieces, once")
        paths = write_twin_model(twin, request.out)
    say(f"the object acts as {acting_words(twin.acts_as)}")
    for path in paths:
        say(f"wrote {path}")
