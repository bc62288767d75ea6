# SPDX-License-Identifier: MIT
"""Writing of a twin's folder, whole or recognisably not."""

import hashlib
from pathlib import Path

import numpy as np

from pinwm_drake.documents import Entry, yaml_text
from pinwm_drake.files import prepare_folder, replacing
from pinwm_drake.reading.contents import read_bytes
from pinwm_drake.rendering.ply import write_ply
from pinwm_drake.twin.document import read_document, to_document
from pinwm_drake.twin.twin import DRAWS_FILE, SURFELS_FILE, TWIN_FILE, Draws, Twin

_MESHES = "meshes"


def write_twin(folder: Path, twin: Twin) -> None:
    """Write `surfels.ply`, the meshes and, last, `twin.yaml`, which holds the SHA-256 of the others.

    A run that is killed in between leaves a folder that `load_twin` refuses, or the earlier twin.

    Args:
        folder: Folder of the twin; made if need be. Other files in it stay.
        twin: The twin. Its meshes are copied.

    Raises:
        InputError: A number of the twin is out of range (the message names its place in `twin.yaml`), a mesh
            cannot be read, or a file cannot be written.
        RenderingError: The surfels are not usable.
    """
    mesh, pusher, pusher_path = f"{_MESHES}/object{twin.mesh_path.suffix.lower()}", None, twin.pusher.mesh_path
    files = {mesh: read_bytes(twin.mesh_path)}
    # A capture may name a mesh that is not there where the pusher has a shape.
    if pusher_path is not None and (twin.pusher.shape is None or pusher_path.is_file()):
        pusher = f"{_MESHES}/pusher{pusher_path.suffix.lower()}"
        files[pusher] = read_bytes(pusher_path)
    document = to_document(twin, mesh, pusher)
    path = folder / TWIN_FILE
    read_document(Entry(path, "", document))
    twin.surfels.check()
    prepare_folder(folder / _MESHES)
    write_ply(folder / SURFELS_FILE, twin.surfels)
    for name, contents in files.items():
        with replacing(folder / name) as temporary:
            temporary.write_bytes(contents)
    files[SURFELS_FILE] = read_bytes(folder / SURFELS_FILE)
    if twin.draws is not None:
        write_draws(folder / DRAWS_FILE, twin.draws)
        files[DRAWS_FILE] = read_bytes(folder / DRAWS_FILE)
    document["sha256"] = {name: hashlib.sha256(contents).hexdigest() for name, contents in sorted(files.items())}
    with replacing(path) as temporary:
        temporary.write_text(yaml_text(document), encoding="utf-8")


def write_draws(path: Path, draws: Draws) -> None:
    """Write the draws of a twin.

    Raises:
        InputError: The file cannot be written.
    """
    with replacing(path) as temporary:
        np.savez(temporary, allow_pickle=False, names=np.array(draws.names), values=draws.values)
