# SPDX-License-Identifier: MIT
"""Reading of a twin's folder, with checks."""

import hashlib
import re
from pathlib import Path, PurePosixPath

import numpy as np

from pinwm_drake.capture.paths import require_file
from pinwm_drake.capture.scene import PusherGeometry
from pinwm_drake.documents import Entry, read_yaml
from pinwm_drake.errors import InputError
from pinwm_drake.models import shipped_twins, twin_path
from pinwm_drake.reading.arrays import read_npz
from pinwm_drake.reading.contents import read_bytes
from pinwm_drake.rendering.ply import read_ply
from pinwm_drake.twin.document import read_document
from pinwm_drake.twin.twin import DRAWS_FILE, SURFELS_FILE, TWIN_FILE, Draws, Twin

_MOST_DRAWS = 2**26  # bytes of all arrays


def load_twin(twin: str | Path) -> Twin:
    """Read a twin and check all of it; its meshes are those in the folder.

    Args:
        twin: Folder of the twin, as `write_twin` leaves it, or the name of one that ships, such as "t_block".

    Raises:
        InputError: A file is missing, unreadable or not the one that `twin.yaml` was written with, a key is
            missing or unknown, a number is out of range or not finite, or a mesh lies outside of the folder.
            The message names file, place and value.
    """
    folder = twin_path(twin)
    if not folder.is_dir():
        raise InputError(
            folder,
            value="no such folder",
            allowed=f"a twin, as `pinwm identify` writes it, or one of {', '.join(shipped_twins())}",
        )
    entry = read_yaml(require_file(folder / TWIN_FILE, "the twin that `pinwm identify` writes"))
    document = read_document(entry)
    paths = {SURFELS_FILE: folder / SURFELS_FILE, document.mesh: _locate(folder, entry["mesh"])}
    pusher, shape = document.pusher.mesh, document.pusher.shape
    if pusher is not None:
        paths[pusher] = _locate(folder, entry["pusher"]["mesh"])
    has_draws = isinstance(document.sha256, dict) and DRAWS_FILE in document.sha256
    if has_draws:
        paths[DRAWS_FILE] = folder / DRAWS_FILE
    _check_hashes(paths, entry["sha256"])
    theta, nuisance = document.estimates()
    return Twin(
        name=document.name,
        mesh_path=paths[document.mesh],
        pusher=PusherGeometry(None if pusher is None else paths[pusher], None if shape is None else shape.shape()),
        gravity=document.gravity,
        floor_height=document.floor.height,
        **document.physics.model_dump(),
        theta=theta,
        nuisance=nuisance,
        camera_offset=document.camera_offset,
        surfels=read_ply(folder / SURFELS_FILE),
        provenance=document.provenance,
        draws=read_draws(folder / DRAWS_FILE) if has_draws else None,
        acts_as=tuple(one.primitive() for one in document.acts_as),
    )


def _locate(folder: Path, entry: Entry) -> Path:
    """Return the file of a name in the folder; raises InputError where it leads out of it."""
    name = PurePosixPath(entry.text())
    inside = not name.is_absolute() and ".." not in name.parts and "\\" not in entry.text()
    try:  # symbolic links followed
        inside = inside and (folder / name).resolve().is_relative_to(folder.resolve())
    except (OSError, RuntimeError):  # links that go round in circles
        inside = False
    if not inside:
        raise entry.refusal("a file in the folder of the twin, named from there")
    return require_file(folder / name, f"the file that {entry.path.name} names under {entry.place}")


def _check_hashes(paths: dict[str, Path], hashes: Entry) -> None:
    hashes.only(*sorted(paths))
    for name, path in sorted(paths.items()):
        expected = hashes[name].text()
        if not re.fullmatch("[0-9a-f]{64}", expected):
            raise hashes[name].refusal("64 hexadecimal digits")
        require_file(path, f"the file that {hashes.path.name} names under sha256")
        found = hashlib.sha256(read_bytes(path)).hexdigest()
        if found != expected:
            allowed = f"{expected[:12]}..., as twin.yaml has it; the file was changed, or is of another run"
            raise InputError(path, value=f"SHA-256 {found[:12]}...", allowed=allowed)


def read_draws(path: Path) -> Draws:
    """Read the draws of a twin.

    Raises:
        InputError: The file is missing, unreadable, or its arrays are no table of finite numbers with a name for each
            column.
    """
    arrays = read_npz(path, "names and values, no pickles", most=_MOST_DRAWS)
    if set(arrays) != {"names", "values"}:
        raise InputError(path, value=f"arrays {sorted(arrays)}", allowed="names and values, no pickles")
    names, values = arrays["names"], arrays["values"]
    if names.dtype.kind != "U":
        raise InputError(path, value=f"names of {names.dtype}", allowed="text")
    if values.ndim != 2 or names.shape != values.shape[1:] or not len(values) or values.dtype.kind != "f":
        raise InputError(path, value=f"names {names.shape}, values {values.shape}", allowed="(p,) and (N, p), N > 0")
    wrong = np.argwhere(~np.isfinite(values))
    if len(wrong):
        row, column = wrong[0]
        raise InputError(path, value=f"{values[row, column]} in row {row} of {names[column]}", allowed="finite numbers")
    return Draws([str(name) for name in names], values)
