# SPDX-License-Identifier: MIT
"""Readers of the package, each with a valid sample in a folder, small, and what makes a damaged one consistent again.

A damaged file whose SHA-256 stands in another file would be refused for that alone, so hashes are made anew.
"""

import contextlib
import hashlib
import json
import shutil
from collections.abc import Callable
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
import torch
import trimesh
import yaml

from benchmarks.hardening.lab_samples import LAB_SAMPLES
from benchmarks.hardening.mutations import dump_yaml, plain_yaml
from pinwm_drake.capture.episodes import read_episode
from pinwm_drake.capture.importers.colmap import read_model
from pinwm_drake.capture.importers.similarity import read_similarity
from pinwm_drake.capture.scene import load_capture
from pinwm_drake.checkpoints import DIGEST, write_arrays
from pinwm_drake.cousins.cousin import CousinDraw, Cousins
from pinwm_drake.cousins.io import hash_cousins, read_cousins, write_cousins
from pinwm_drake.experiments.evaluation.store import EpisodeStore
from pinwm_drake.geometry.meshes import load_mesh, load_pieces
from pinwm_drake.identification.adam import AdamState
from pinwm_drake.identification.checkpoint import Checkpoint
from pinwm_drake.identification.history import Log, read_history, write_history
from pinwm_drake.learning.bundle import HASHED, PROVENANCE_FILE, provenance_hash, read_bundle
from pinwm_drake.learning.evaluation import EpisodeResult
from pinwm_drake.learning.policy import read_policy, write_policy
from pinwm_drake.learning.rounds import CHECKPOINT_FILE, Rounds, StageRun
from pinwm_drake.learning.weights import pack, unpack
from pinwm_drake.models import policy_path, resolve, twin_path
from pinwm_drake.paper.reproduce.cell import DONE_FILE, CellStore, settings_of
from pinwm_drake.paper.reproduce.twins import CaptureCell, NoisyCaptureCell, SurfelsCell
from pinwm_drake.reading.arrays import read_npz
from pinwm_drake.rendering.fit_options import FitOptions
from pinwm_drake.rendering.fitting import fit
from pinwm_drake.rendering.painted import painted_surfels
from pinwm_drake.rendering.ply import read_ply, write_ply
from pinwm_drake.report.evaluation.episode import EpisodeRecord
from pinwm_drake.report.surfels.fit_results import read_offset, read_registration
from pinwm_drake.systems.scenario.load import load_setup, scenario_path
from pinwm_drake.tasks.waypoints import Waypoints
from pinwm_drake.twin.read import load_twin, read_draws
from tests.capture.cube import read_static_views, write_mesh
from tests.capture.pushed_cube import read_frames, write_pushed_cube
from tests.capture.test_colmap import model_of, write_binary, write_text
from tests.learning.bundles import image_spec, untrained_policy
from tests.rendering.boxes import box, views_around
from tests.rendering.scenes import cloud

Make = Callable[[Path], object]
Read = Callable[[Path], object]
_LARGE = 2**25  # bytes
_ABOUT = {"a": 1, "options": {"b": [2.0]}}
_FIT = FitOptions(
    iterations=4, max_surfels=60, first_surfels=50, sh_degree=1, held_out=3, num_threads=1, evaluate_every=2
)


@dataclass(frozen=True)
class Reader:
    """A reader.

    Attributes:
        make: Writes a valid sample into an empty folder.
        read: Reads what is in the folder.
        mend: Makes hashes of a damaged sample anew, where that is possible.
        sealed: Pattern of the names of files of which no other contents may be read without new hashes.
    """

    make: Make
    read: Read
    mend: Make = lambda folder: None
    sealed: str = ""


def _rehash_bundle(folder: Path) -> None:
    path = folder / PROVENANCE_FILE
    document = json.loads(path.read_text())
    document["files"] = {name: _sha256(folder / name) for name in HASHED}
    path.write_text(json.dumps(document | {"sha256": provenance_hash(document)}))


def _rehash_twin(folder: Path) -> None:
    document = plain_yaml(folder / "twin.yaml")
    document["sha256"] = {name: _sha256(folder / name) for name in document["sha256"]}
    (folder / "twin.yaml").write_text(dump_yaml(document))


def _rehash_align(folder: Path) -> None:
    document = json.loads((folder / "align.json").read_text())
    document["surfels_sha256"] = _sha256(folder / "surfels.ply")
    (folder / "align.json").write_text(json.dumps(document))


def _rehash_arrays(folder: Path) -> None:
    """Write an npz of a checkpoint anew, with the digest of its arrays; its "about" may be damaged."""
    for path in folder.rglob("*.npz"):
        arrays = read_npz(path, "arrays", most=_LARGE)
        about = json.loads(str(arrays.pop("about")))
        about.pop(DIGEST, None)
        write_arrays(path, about, arrays)


def _rehash_cousins(folder: Path) -> None:
    arrays = read_npz(folder / "cousins.npz", "arrays", most=_LARGE)
    about = json.loads(str(arrays.pop("about")))
    about.pop("sha256")
    about.pop(DIGEST, None)
    write_arrays(folder / "cousins.npz", about | {"sha256": hash_cousins(about, arrays)}, arrays)


def _sha256(path: Path) -> str:
    return hashlib.sha256(path.read_bytes()).hexdigest()


def mend(reader: Reader, folder: Path) -> None:
    """Make the hashes of a damaged sample anew, as far as there are files to make them of."""
    for path in folder.rglob("*"):
        if path.is_symlink() or not (path.is_dir() or path.is_file()) or path.stat().st_size > _LARGE:
            return
    with contextlib.suppress(Exception):
        reader.mend(folder)


def _capture(folder: Path) -> None:
    write_pushed_cube(folder)
    for path in [
        *sorted((folder / "static/images").glob("*"))[3:],
        *sorted((folder / "episodes/0000/rgb").glob("*"))[3:],
    ]:
        path.unlink()
    transforms = json.loads((folder / "static/transforms.json").read_text())
    (folder / "static/transforms.json").write_text(json.dumps(transforms | {"frames": transforms["frames"][:3]}))
    for name in ("frames.csv", "object_poses.csv"):
        path = folder / "episodes/0000" / name
        if path.exists():
            path.write_text("\n".join(path.read_text().splitlines()[:4]) + "\n")


def _read_capture(folder: Path) -> object:
    capture = load_capture(folder)
    views = read_static_views(folder)
    return capture, views, [read_frames(read_episode(capture, name)) for name in capture.episode_names]


def _colmap(write: Callable[..., object]) -> Make:
    def make(folder: Path) -> None:
        write_pushed_cube(folder / "capture")
        write(folder / "model", *model_of(folder / "capture/static"))
        shutil.rmtree(folder / "capture")

    return make


def _mesh(suffix: str) -> Reader:
    def read(folder: Path) -> object:
        return load_mesh(folder / f"a{suffix}"), load_pieces(folder / f"a{suffix}")

    return Reader(lambda folder: trimesh.creation.box((0.1, 0.2, 0.3)).export(folder / f"a{suffix}"), read)


def _painted(folder: Path) -> None:
    (folder / "a.mtl").write_text("newmtl red\nKd 1 0 0\n")
    write_mesh(folder / "a.obj")
    text = (folder / "a.obj").read_text()
    (folder / "a.obj").write_text("mtllib a.mtl\n" + text.replace("\nf ", "\nusemtl red\nf ", 1))


def _history(folder: Path) -> None:
    log = Log()
    for k in range(5):
        log.add("coarse", k % 2, 0.1 * k, [0.3, 0.2])
    write_history(folder / "history.npz", ["mass", "friction_floor"], log)


def _train_parts() -> tuple[torch.nn.Module, torch.optim.Optimizer]:
    torch.manual_seed(0)
    network = torch.nn.Linear(3, 2)
    optimizer = torch.optim.Adam(network.parameters())
    network(torch.ones(1, 3)).sum().backward()
    optimizer.step()
    return network, optimizer


def _train(folder: Path) -> None:
    rows = np.array([[k, 100.0 * (k + 1), 0.5, 20.0, 0.1, 3.0 * (k + 1)] for k in range(3)])
    write_arrays(folder / CHECKPOINT_FILE, _ABOUT, {**pack(*_train_parts()), "history": rows})


def _read_train(folder: Path) -> object:
    rounds = Rounds(StageRun(folder, "student", about=_ABOUT, resume=True), 5)
    if rounds.number:
        unpack(rounds.arrays, *_train_parts())
    return rounds.number, rounds.arrays


def _read_history(folder: Path) -> object:
    found = read_history(folder / "history.npz")  # one that diverged is drawn as well
    return replace(found, loss=np.nan_to_num(found.loss), theta=np.nan_to_num(found.theta))


def _losses(losses: np.ndarray) -> np.ndarray:
    """Losses, of which those where the physics has no solution are infinite, as finite numbers."""
    return np.where(np.isposinf(losses), 0.0, losses)


def _identify(folder: Path, *, read: bool = False) -> object:
    kept = Checkpoint(folder, _ABOUT, resume=read, every=1, size=2)
    if read:
        state = kept.load_adam("fine0.0")
        best = None if state is None else _losses(state.best_loss.numpy())
        done = {name: _losses(one) if name.endswith("loss") else one for name, one in kept.done.items()}
        return best, state and vars(state) | {"best_loss": 0.0}, done
    kept.log.add("coarse", 0, 0.1, [0.3, 0.2])
    kept.end("coarse", {"z": torch.zeros(4, 2, dtype=torch.float64), "loss": torch.ones(4, dtype=torch.float64)})
    state = AdamState.at(torch.zeros(4, 2, dtype=torch.float64))
    state.iteration = 1
    kept.save_adam("fine0.0", state)
    return None


def _evaluation(folder: Path) -> None:
    q, p = np.tile([1.0, 0, 0, 0], (4, 1)), np.zeros((4, 3))
    result = EpisodeResult(0, True, 3, 0.01, 0.1)
    views = np.zeros((2, 4, 4, 3), np.uint8)
    record = EpisodeRecord(result, q, p, p.copy(), views, np.array([0, 2]), seconds=1.0, cpu_seconds=1.0)
    EpisodeStore(folder, _ABOUT, resume=True).write(0, record)


def _read_evaluation(folder: Path) -> object:
    return EpisodeStore(folder, _ABOUT, resume=True).read(0)


_CELL = SurfelsCell(NoisyCaptureCell(CaptureCell(task="push", seed=0), 0.01))


def _cell(folder: Path) -> None:
    cell = _CELL
    done = {"settings": settings_of(cell), "result": {"a": 1.0}, "provenance": {"minutes": 1.0}}
    CellStore(folder).root.joinpath(cell.key).mkdir(parents=True)
    (folder / cell.key / DONE_FILE).write_text(json.dumps(done))


def _bundle(folder: Path) -> None:
    shutil.copytree(policy_path("push_t"), folder, dirs_exist_ok=True)


def _fit(folder: Path, *, read: bool = False) -> object:
    found = fit(views_around(box()), box(), _FIT, folder=folder, resume=read)
    return found.surfels, found.psnr_train, found.psnr_test, found.camera_offset


def _twin(folder: Path) -> None:
    shutil.copytree(twin_path("t_block"), folder, dirs_exist_ok=True)


def _cousins(folder: Path) -> None:
    draw = CousinDraw(load_twin("t_block"), seed=0)
    write_cousins(folder / "cousins.npz", Cousins(draw, (draw.cousin(0), draw.cousin(1))))


def _read_cousins(folder: Path) -> object:
    return read_cousins(folder / "cousins.npz", load_twin("t_block"))


def _waypoints(folder: Path) -> None:
    Waypoints(np.zeros((3, 13)), np.zeros((3, 3)), np.zeros((3, 3))).write(folder, {})


def _policy(folder: Path) -> None:
    write_policy(folder, untrained_policy(image_spec(16, 1)))


def _align(folder: Path) -> None:
    write_ply(folder / "surfels.ply", cloud(20))
    record = {"camera_offset": [0.1, 0.2], "object": {"X_OS": {"q": [1.0, 0, 0, 0], "p": [0.0, 0, 0]}}}
    (folder / "align.json").write_text(json.dumps(record))
    _rehash_align(folder)


def _read_align(folder: Path) -> object:
    offset = read_offset(folder / "align.json")
    return read_ply(folder / "surfels.ply"), offset, read_registration(folder / "align.json")


def _similarity(folder: Path) -> None:
    (folder / "world.yaml").write_text(yaml.safe_dump({"matrix": np.diag([2.0, 2.0, 2.0, 1.0]).tolist()}))


def _scenario(folder: Path) -> None:
    shutil.copyfile(resolve(scenario_path("push_t")), folder / "a.scenario.yaml")


def _draws(folder: Path) -> None:
    shutil.copyfile(twin_path("t_block") / "draws.npz", folder / "draws.npz")


READERS: dict[str, Reader] = {
    "capture": Reader(_capture, _read_capture),
    "colmap, text": Reader(_colmap(write_text), lambda folder: read_model(folder / "model")),
    "colmap, binary": Reader(_colmap(write_binary), lambda folder: read_model(folder / "model")),
    "similarity": Reader(_similarity, lambda folder: read_similarity(folder / "world.yaml")),
    "mesh, obj": _mesh(".obj"),
    "mesh, stl": _mesh(".stl"),
    "mesh, ply": _mesh(".ply"),
    "mesh, glb": _mesh(".glb"),
    "painted mesh": Reader(_painted, lambda folder: painted_surfels(folder / "a.obj", 100)),
    "surfels": Reader(lambda folder: write_ply(folder / "a.ply", cloud(20)), lambda folder: read_ply(folder / "a.ply")),
    "fit results": Reader(_align, _read_align, _rehash_align, r"surfels\.ply"),
    "fit checkpoint": Reader(_fit, lambda folder: _fit(folder, read=True), _rehash_arrays, r".*\.npz"),
    "identify checkpoint": Reader(_identify, lambda folder: _identify(folder, read=True), _rehash_arrays, r".*\.npz"),
    "train checkpoint": Reader(_train, _read_train, _rehash_arrays, r".*\.npz"),
    "waypoints": Reader(_waypoints, Waypoints.read, _rehash_arrays, r".*\.npz"),
    "evaluated episode": Reader(_evaluation, _read_evaluation, _rehash_arrays, r".*\.npz"),
    "cell": Reader(_cell, lambda folder: CellStore(folder).read(_CELL)),
    "history": Reader(_history, _read_history),
    "draws": Reader(_draws, lambda folder: read_draws(folder / "draws.npz")),
    "twin": Reader(_twin, load_twin, _rehash_twin, r"(?!twin\.yaml).*"),
    "cousins": Reader(_cousins, _read_cousins, _rehash_cousins, r"cousins\.npz"),
    "policy": Reader(_policy, read_policy, _rehash_arrays, r".*\.npz"),
    "bundle": Reader(_bundle, read_bundle, _rehash_bundle, ".*"),
    "scenario": Reader(_scenario, lambda folder: load_setup(folder / "a.scenario.yaml")),
    **{name: Reader(make, read) for name, (make, read) in LAB_SAMPLES.items()},
}
