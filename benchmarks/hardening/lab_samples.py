# SPDX-License-Identifier: MIT
"""Samples of what a lab brings: logs, recordings, films, data sets, stations, starts and tables of poses; small."""

from collections.abc import Callable
from pathlib import Path

import numpy as np
import torch
from PIL import Image

from pinwm_drake.capture.clock import EpisodeClock, read_clock, write_clock
from pinwm_drake.capture.episodes import read_start
from pinwm_drake.capture.importers.columns import make_trajectory, parse_columns
from pinwm_drake.capture.importers.recordings import read_film, read_log
from pinwm_drake.capture.measured_poses import read_measured_poses
from pinwm_drake.spatial.poses import Pose
from pinwm_drake.station.document import load_station, write_station
from pinwm_drake.station.eye import eye_of
from pinwm_drake.station.lab import load_lab
from tests.capture.test_bag import write_bag
from tests.capture.test_lcm_log import event, image_message, signal_message
from tests.capture.test_lerobot import write_v2, write_v3
from tests.capture.test_video import plain, write_mp4
from tests.station.stations import station_document
from tests.station.test_lab import CSV, LAB

_STATE = "px=observation.state.x,py=observation.state.1,pz=observation.state.z"
_REST = Pose(torch.tensor([1.0, 0, 0, 0], dtype=torch.float64), torch.zeros(3, dtype=torch.float64))


def _film(name: str = "", topic: str | None = None) -> Callable[[Path], object]:
    def read(folder: Path) -> object:
        film = read_film(folder / name, topic=topic)
        return film.t, list(film.frames(range(len(film.t))))

    return read


def _log(name: str = "", columns: str = "", topic: str | None = None) -> Callable[[Path], object]:
    return lambda folder: make_trajectory(read_log(folder / name, topic=topic), parse_columns(columns))


def _csv(folder: Path) -> None:
    rows = "".join(f"{20 * k},{k},0,30,{k},1,0,0,0,50,0,0,1,2,3\n" for k in range(12))
    head = "# robot\ntime [ms],x [mm],y [mm],z [mm],mode,qw,qx,qy,qz,vx [mm/s],vy [mm/s],vz [mm/s],fx,fy,fz\n"
    (folder / "robot.csv").write_text(head + rows)


def _images(folder: Path) -> None:
    for k in range(4):
        Image.fromarray(plain(20 * k)).save(folder / f"{k}.png")
    (folder / "stamps.csv").write_text("frame,t\n" + "".join(f"{k},{0.04 * k}\n" for k in range(4)))


def _lcm(folder: Path) -> None:
    parts = [event(k, "IMAGES", image_message(k)) + event(k, "STATE", signal_message(k)) for k in range(6)]
    (folder / "push.lcmlog").write_bytes(b"".join(parts))


def _bag(folder: Path) -> None:
    write_bag(folder / "bag")


def _read_bag(folder: Path) -> object:
    films = [_film("bag", topic)(folder) for topic in ("/camera", "/small")]
    return *films, _log("bag", topic="/pose,/twist")(folder), _log("bag", topic="/tf:tool")(folder)


def _both(film: Callable[[Path], object], log: Callable[[Path], object]) -> Callable[[Path], object]:
    return lambda folder: (film(folder), log(folder))


def _lab(folder: Path) -> None:
    for kind in ("robot", "lens"):
        (folder / kind).mkdir()
    for name in ("robot/a", "robot/b", "lens/c"):
        (folder / f"{name}.jpg").touch()
    (folder / "lab.yaml").write_text(LAB)
    (folder / "robot.csv").write_text(CSV)


def _read_lab(folder: Path) -> object:
    lab = load_lab(folder)
    return lab.document.printed_board(), [photo.X_BE for photo in lab.photos]


def _station(folder: Path) -> None:
    write_station(folder / "station.yaml", station_document())


def _read_station(folder: Path) -> object:
    station = load_station(folder)
    return station.document, eye_of(station)


def _start(folder: Path) -> None:
    (folder / "start.yaml").write_text("X_WO: {p: [0.1, 0.2, 0], q: [1.0, 0.0, 0.0, 0.0]}\nV_WO: [0, 0, 0, 1, 0, 0]\n")
    write_clock(folder, EpisodeClock(schema_version=1, offset=0.1, deviation=0.0, interval=(0, 1), film="a", log="b"))


def _poses(folder: Path) -> None:
    rows = np.column_stack([0.1 * np.arange(6), np.zeros((6, 3)), np.tile([1, 0, 0, 0], (6, 1))])
    np.savetxt(folder / "poses.csv", rows, delimiter=",", header="t,px,py,pz,qw,qx,qy,qz", comments="")


LAB_SAMPLES: dict[str, tuple[Callable[[Path], object], Callable[[Path], object]]] = {
    "log, CSV": (_csv, _log("robot.csv")),
    "film, MP4": (lambda folder: write_mp4(folder / "push.mp4"), _film("push.mp4")),
    "film, images": (_images, _film()),
    "recording, rosbag": (_bag, _read_bag),
    "recording, LCM": (_lcm, _both(_film("push.lcmlog"), _log("push.lcmlog"))),
    "recording, LeRobot v2": (lambda folder: write_v2(folder / "set"), _both(_film("set"), _log("set", _STATE))),
    "recording, LeRobot v3": (lambda folder: write_v3(folder / "set"), _both(_film("set"), _log("set", _STATE))),
    "lab": (_lab, _read_lab),
    "station": (_station, _read_station),
    "start and clock": (_start, lambda folder: (read_start(folder), read_clock(folder))),
    "poses": (_poses, lambda folder: read_measured_poses(folder / "poses.csv", _REST)),
}
