# SPDX-License-Identifier: MIT
"""Requests of commands of a lab: mask, pose, mesh, and the guide from a new folder to a policy."""

from pathlib import Path
from typing import Annotated

from pinwm_drake.request import BUDGET, DATA, LAB, argument, option, request

_Folder = Annotated[Path, argument("Capture: a folder with static/transforms.json.", "CAPTURE", completes="capture")]
_Size = Annotated[
    float | None,
    option(
        "Largest extent of the object.",
        unit="m",
        ge=1e-3,
        le=5.0,
        group=DATA,
        default="the mesh's, or the cameras tell",
    ),
]


@request
class MaskRequest:
    """Request of masks: what `pinwm mask` does."""

    folder: _Folder
    size: _Size = None
    mesh: Annotated[bool, option("Use the mesh of the capture, where there is one.", group=DATA)] = True
    segmenter: Annotated[
        tuple[Path, ...],
        option("ONNX file of a network that cuts out objects; repeat it for a chain.", group=LAB),
    ] = ()


@request
class PoseRequest:
    """Request of the pose at the start: what `pinwm pose` does."""

    folder: _Folder
    poses: Annotated[
        Path | None,
        option("CSV of poses by another estimator: t, px, py, pz, qw, qx, qy, qz.", "--from", group=DATA),
    ] = None
    view: Annotated[str | None, option("Name of the only static view to use, for its doubt.", "--view", group=DATA)] = (
        None
    )
    write: Annotated[bool, option("Write the pose to capture.yaml.", group=DATA)] = True


@request
class MeshRequest:
    """Request of a mesh: what `pinwm mesh` does."""

    folder: _Folder
    source: Annotated[
        Path | None, option("CAD file or scan.", "--from", group=DATA, default="the depths, or else the masks")
    ] = None
    out: Annotated[Path | None, option("File of the mesh, .obj.", group=DATA, default="CAPTURE/meshes/object.obj")] = (
        None
    )
    replace: Annotated[bool, option("Replace a mesh that is there.", group=DATA)] = False


@request
class NewLabRequest:
    """Request of a new lab: what `pinwm lab new` does."""

    folder: Annotated[Path, argument("Folder of the lab, new or empty.", "LAB")]


@request
class GuideRequest:
    """Request of the guide: what `pinwm lab LAB` does."""

    folder: Annotated[Path, argument("Folder that `pinwm lab new` made.", "LAB")]
    train: Annotated[bool, option("Train a policy, where all before it is done.", "--train", group=BUDGET)] = False
    run: Annotated[bool, option("Run what is ready; else it is only looked at.")] = True
