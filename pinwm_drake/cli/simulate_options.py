"""The options of `pinwm simulate`, and the setup that they name."""

import dataclasses
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from pinwm_drake.capture.episode_tables import TRAJECTORY_FILE
from pinwm_drake.errors import InputError, ParameterError
from pinwm_drake.geometry.meshes import load_mesh
from pinwm_drake.systems.scenario.load import read_setup, scenario_path, shipped_scenarios
from pinwm_drake.systems.scenario.schema import ENGINES, Scenario, View, load_scenario
from pinwm_drake.systems.scenario.setup import Setup, make_setup
from pinwm_drake.systems.scenario.start import level_height

STRAIGHT = "straight"
_USUAL_REACH = 0.085  # m, of the T-block, which the default camera sees well


@dataclass(frozen=True)
class SimulateOptions:
    """The options of `pinwm simulate`, named and in units as there.

    Raises:
        ParameterError: One is out of range.
    """

    engine: str | None
    seed: int | None
    duration: float | None
    push: str
    meshcat: bool
    host: str
    port: int | None
    record: Path | None
    video: Path | None
    out: Path | None

    def __post_init__(self) -> None:
        """Checks every option."""
        _require("--engine", self.engine, self.engine in (None, *ENGINES), ", ".join(ENGINES))
        _require("--seed", self.seed, self.seed is None or 0 <= self.seed < 2**32, "0 to 4294967295")
        _require("--duration", self.duration, self.duration is None or 0.01 <= self.duration <= 600, "0.01 to 600 s")
        for name, path, suffixes in (("--record", self.record, (".html", ".htm")), ("--video", self.video, (".mp4",))):
            fits = path is None or path.suffix.lower() in suffixes
            _require(name, path, fits, f"a name that ends in {' or '.join(suffixes)}")

    @property
    def log_folder(self) -> Path | None:
        """The folder of the trajectory.csv that is to be replayed; None for a straight push.

        Raises:
            InputError: `push` is something else.
        """
        if self.push == STRAIGHT:
            return None
        path = Path(self.push)
        if path.name != TRAJECTORY_FILE:
            raise InputError(self.push, allowed=f"{STRAIGHT}, or the path of a {TRAJECTORY_FILE}")
        return path.parent


def find_setup(scenario: str | None, twin: Path | None) -> Setup:
    """Loads what is to be simulated.

    Args:
        scenario: A scenario's file, the name of one that ships, a `package://` URL, or a twin's folder.
        twin: A twin's folder, in place of the object of the scenario; or None.

    Returns:
        The setup, of one world. For a twin without a scenario the pusher is as high as the object's centre of mass,
        and the camera farther away where the object is large.

    Raises:
        InputError: A file cannot be used, or there is none of that name.
        ParameterError: Neither was given, or periods and time steps do not divide each other.
    """
    if scenario is None:
        if twin is None:
            raise ParameterError(
                f"SCENARIO: got none, and no --twin; allowed: a file, {', '.join(shipped_scenarios())}"
            )
        return _twin_setup(twin)
    if Path(scenario).is_dir():
        if twin is not None:
            raise ParameterError(f"--twin: got {twin} beside the folder {scenario}; allowed: one of the two")
        return _twin_setup(Path(scenario))
    found = load_scenario(scenario_path(scenario))
    if twin is not None:
        found = dataclasses.replace(found, object=None, theta=None, twin=str(twin))
    return make_setup(dataclasses.replace(found, num_worlds=1))


def _twin_setup(folder: Path) -> Setup:
    """The setup of a twin that has no scenario."""
    setup = read_setup(str(folder))
    floor = setup.twin.floor_height
    reach = float(np.linalg.norm(load_mesh(setup.twin.mesh_path).vertices, axis=1).max())
    size = max(reach / _USUAL_REACH, 1.0)
    usual = View()
    p_WC, p_WT = (size * np.array(point) + [0.0, 0.0, floor] for point in (usual.p_WC, usual.p_WT))
    scenario: Scenario = dataclasses.replace(
        setup.scenario,
        start=dataclasses.replace(setup.scenario.start, pusher_height=level_height(setup)),
        camera=dataclasses.replace(usual, p_WC=p_WC.tolist(), p_WT=p_WT.tolist()),
    )
    return make_setup(scenario)


def _require(name: str, value: object, allowed: bool, range_in_words: str) -> None:
    if not allowed:
        raise ParameterError(f"{name}: got {value}; allowed: {range_in_words}")
