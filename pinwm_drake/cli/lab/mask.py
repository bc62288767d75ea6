# SPDX-License-Identifier: MIT
"""`pinwm mask`: a bar, and the doubtful views in lines."""

from pinwm_drake.cli.console import say, stages_bar
from pinwm_drake.experiments.requests.lab import MaskRequest


def mask(request: MaskRequest) -> None:
    """Cut the object out of all images of a capture.

    Masks made by hand, and images with alpha, stay as they are.
    """
    from pinwm_drake.experiments.masking import mask_capture

    with stages_bar() as show:
        found = mask_capture(
            request.folder,
            size=request.size,
            segmenter=request.segmenter,
            use_mesh=request.mesh,
            progress=lambda stage, done, figures: show(stage, done, figures),
        )
    for line in found.words():
        say(line, style="yellow" if line.startswith("doubtful") else None)
