"""What `pinwm simulate` does."""

import contextlib
import logging
import math
from collections.abc import Iterator
from pathlib import Path

import numpy as np
from pydrake.common import RandomGenerator
from pydrake.geometry import Meshcat
from rich.console import Console
from rich.progress import BarColumn, Progress, TextColumn
from rich.table import Table

from pinwm_drake.capture.episode_tables import PusherTrajectory, read_trajectory
from pinwm_drake.cli.simulate_options import SimulateOptions
from pinwm_drake.errors import InputError, ParameterError
from pinwm_drake.files import appearing, prepare_folder
from pinwm_drake.report.video import write_video
from pinwm_drake.systems.pusher.choice import random_push
from pinwm_drake.systems.runs.episode import Episode, Record
from pinwm_drake.systems.runs.episode_folder import EpisodeFolder, start_of_log
from pinwm_drake.systems.runs.film import Film
from pinwm_drake.systems.scenario.load import load_setup, shipped_scenarios
from pinwm_drake.systems.scenario.start import Place
from pinwm_drake.systems.station.station import MakePushStation, PushStation
from pinwm_drake.systems.view.scene import make_meshcat, recorded

_FRAME_RATE = 30.0  # 1/s, of video and images, in simulated time
_LOOPBACK = ("127.", "localhost", "::1")


def run_simulate(scenario: str | None, twin: Path | None, options: SimulateOptions) -> None:
    """Simulates an episode, and more of them where Meshcat shows them.

    Args:
        scenario: What there is; see `load_setup`.
        twin: Folder of a twin in place of the scenario's object, or None.
        options: The options.

    Raises:
        PinwmError: An input was refused, the physics found no solution, or a file cannot be written.
    """
    console = Console()
    logging.getLogger("drake").setLevel(logging.WARNING)  # Meshcat's address is said below
    log = None if options.log_folder is None else read_trajectory(options.log_folder)
    for path in (options.record, options.video):
        if path is not None:
            _require_free(path)
    scene = twin if scenario is None else scenario
    if scene is None:
        allowed = f"a file, {', '.join(shipped_scenarios())}, or a twin's folder"
        raise ParameterError(f"SCENARIO: got none, and no --twin; allowed: {allowed}")
    setup = load_setup(scene, twin=None if scenario is None else twin)
    meshcat = None
    if options.meshcat or options.record is not None:
        meshcat = make_meshcat(options.host, options.port)
    station = MakePushStation(setup, options.engine, meshcat=meshcat)
    seed = setup.scenario.seed if options.seed is None else options.seed
    session = Session(station, options, log, seed)
    if options.meshcat:
        _announce(console, meshcat, options.host)
    try:
        session.first(console, meshcat)
        while options.meshcat:
            session.another()
    except KeyboardInterrupt:
        if not options.meshcat:
            raise
        console.print("ended", highlight=False)


class Session:
    """One push after another in a station."""

    def __init__(self, station: PushStation, options: SimulateOptions, log: PusherTrajectory | None, seed: int) -> None:
        """Makes the diagram; `seed` is that of starts and pushes."""
        self.station, self.options = station, options
        self.episode = Episode(station, log)
        if options.meshcat:
            self.episode.simulator.set_target_realtime_rate(1.0)
        self._starts, self._pushes = RandomGenerator(seed), np.random.default_rng([seed, 1])

    def another(self) -> None:
        """Draws a push and makes it."""
        self._begin()
        for _ in self.episode.advance(self.options.duration):
            pass

    def first(self, console: Console, meshcat: Meshcat | None) -> None:
        """Draws a push, makes it, writes what is wanted of it, and says what came of it."""
        options, station = self.options, self.station
        before = _retries(station)
        with contextlib.ExitStack() as stack:
            if options.record is not None and meshcat is not None:
                stack.enter_context(recorded(meshcat, options.record, _FRAME_RATE))
            folder = None
            if options.out is not None:
                folder = EpisodeFolder(stack.enter_context(appearing(options.out)), station.setup)
            self._begin()
            film = None if options.video is None else Film(station.setup, station.engine.name)
            frames = self._frames(console, film, folder)
            if options.video is not None and film is not None:
                write_video(options.video, frames, rate=_FRAME_RATE, size=film.size)
            else:
                for _ in frames:
                    pass
            record = self.episode.record
            if folder is not None:
                folder.finish(record)
        console.print(_summary(station, record, _retries(station) - before))
        for path in (options.out, options.video, options.record):
            if path is not None:
                console.print(f"wrote {path}", highlight=False, soft_wrap=True, markup=False)

    def _begin(self) -> None:
        """Puts object and pusher to a new start."""
        setup, place = self.station.setup, self.episode.draw_place(self._starts)
        if self.options.log_folder is None:
            self.episode.begin(place, random_push(setup, place.X_WO, self._pushes))
        else:
            X_WO = start_of_log(self.options.log_folder, setup)
            self.episode.begin(place if X_WO is None else Place(X_WO, place.p_WP))

    def _frames(self, console: Console, film: Film | None, folder: EpisodeFolder | None) -> Iterator[np.ndarray]:
        """Simulates; yields the frames of the film, if there is one, and adds images to the folder, if there is one."""
        longest, number = self.episode.longest(self.options.duration), 0
        columns = (TextColumn("{task.description}"), BarColumn(bar_width=20), TextColumn("{task.fields[words]}"))
        with Progress(*columns, console=console, transient=True, disable=not console.is_terminal) as progress:
            task = progress.add_task(self.station.engine.name, total=longest, words="")
            for t in self.episode.advance(self.options.duration):
                rate = t / max(self.episode.wall_time, 1e-9)
                progress.update(task, completed=t, words=f"{t:.2f} of {longest:.2f} s at most, {rate:.2f} x real time")
                if (film is None and folder is None) or t < number / _FRAME_RATE - 1e-6:
                    continue
                number += 1
                context = self.episode.simulator.get_context()
                mine = self.station.GetMyContextFromRoot(context)
                rgb = self.station.GetOutputPort("rgb").Eval(mine).data
                if folder is not None:
                    folder.add(t, rgb)
                if film is not None:
                    p_WP = self.station.GetOutputPort("pusher_state").Eval(mine)[:3]
                    yield film.frame(t, self.station.object_pose(context), p_WP, rgb)


def _retries(station: PushStation) -> int:
    """How often the twin's steps had to be made shorter; plants know nothing of the kind."""
    return 0 if station.world is None else station.world.physics.retries


def _require_free(path: Path) -> None:
    """Makes the folder of a file; raises InputError where a folder has its name."""
    if path.is_dir():
        raise InputError(path, value="a folder", allowed="a file")
    prepare_folder(path.parent)


def _announce(console: Console, meshcat: Meshcat | None, host: str) -> None:
    console.print(f"Meshcat is at {'' if meshcat is None else meshcat.web_url()}", highlight=False, soft_wrap=True)
    if not host.startswith(_LOOPBACK):
        console.print(f"[yellow]Other machines can open it too, as it listens on {host}.[/]")
    console.print("Ctrl-C ends.")


def _summary(station: PushStation, record: Record, retries: int) -> Table:
    """What came out."""
    table = Table(show_header=False, title=station.setup.scenario.name)
    x, y, z = 1e3 * record.displacement
    table.add_row("engine", station.engine.name)
    table.add_row("object moved", f"{math.hypot(x, y, z):.1f} mm ({x:+.1f}, {y:+.1f}, {z:+.1f})")
    table.add_row("object turned", f"{math.degrees(record.rotation):.1f}°")
    table.add_row("at rest", "yes" if record.at_rest else "no")
    table.add_row("simulated", f"{record.t[-1]:.3f} s, {record.t[-1] / record.wall_time:.2f} x real time")
    table.add_row("solver retries", "not known" if station.world is None else str(retries))
    return table
