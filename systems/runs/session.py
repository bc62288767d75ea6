# SPDX-License-Identifier: MIT
"""A session of random pushes, or of a replayed log, in a station, with film, recording and episode folder."""

import contextlib
from collections.abc import Callable, Iterator

import numpy as np
from pydrake.common import RandomGenerator
from pydrake.geometry import Meshcat

from pinwm_drake.capture.episode_tables import read_trajectory
from pinwm_drake.files import appearing, prepare_folder
from pinwm_drake.report.video import write_video
from pinwm_drake.systems.pusher.choice import random_push
from pinwm_drake.systems.runs.episode import Episode, Record
from pinwm_drake.systems.runs.episode_folder import EpisodeFolder, start_of_log
from pinwm_drake.systems.runs.film import Film
from pinwm_drake.systems.runs.session_options import SessionOptions
from pinwm_drake.systems.scenario.load import Scene, load_setup
from pinwm_drake.systems.scenario.setup import Setup
from pinwm_drake.systems.scenario.start import Place
from pinwm_drake.systems.station.station import SceneStation, make_station
from pinwm_drake.systems.view.meshcat import make_meshcat, recorded

SessionProgress = Callable[[str, float, str], None]
_FRAME_RATE = 30.0  # 1/s, of video and images, in simulated time


class Session:
    """One push after another in a station.

    Attributes:
        station: The station.
        meshcat: The page that shows it, or None.
        options: Of the session.
        episode: The station, its pusher's script and its simulator.
        retries: Steps of the twin that had to be made shorter in `first`.
    """

    def __init__(self, setup: Setup, options: SessionOptions) -> None:
        """Make station and diagram, and the page where the options ask for one.

        Args:
            setup: The scene.
            options: Of the session.

        Raises:
            PinwmError: A log cannot be read, or the station cannot be made.
        """
        log = None if options.log_folder is None else read_trajectory(options.log_folder)
        self.meshcat: Meshcat | None = None
        if options.meshcat or options.record is not None:
            self.meshcat = make_meshcat(options.host, options.port)
        self.station = make_station(setup, options.engine, meshcat=self.meshcat)
        self.options, self.retries = options, 0
        self.episode = Episode(self.station, log)
        if options.meshcat:
            self.episode.simulator.set_target_realtime_rate(1.0)
        seed = setup.scenario.seed if options.seed is None else options.seed
        self._starts, self._pushes = RandomGenerator(seed), np.random.default_rng([seed, 1])

    def another(self, stop: Callable[[], object] = lambda: False) -> None:
        """Draws a push and makes it.

        Args:
            stop: Asked after each step of the script; what is true ends the push there.
        """
        self._begin()
        for _ in self.episode.advance(self.options.duration):
            if stop():
                return

    def first(self, progress: SessionProgress = lambda stage, done, figures: None) -> Record:
        """Draws a push, makes it, and writes what is wanted of it.

        Args:
            progress: Called with the engine's name, the share of the longest time, and the time in words.

        Returns:
            The motion; `retries` counts the twin's steps that had to be made shorter in it.
        """
        options, station = self.options, self.station
        before = _retries(station)
        with contextlib.ExitStack() as stack:
            if options.record is not None and self.meshcat is not None:
                stack.enter_context(recorded(self.meshcat, options.record, _FRAME_RATE))
            folder = None
            if options.out is not None:
                folder = EpisodeFolder(stack.enter_context(appearing(options.out)), station.setup)
            self._begin()
            film = None if options.video is None else Film(station.setup, station.engine.name)
            frames = self._frames(progress, film, folder)
            if options.video is not None and film is not None:
                write_video(options.video, frames, rate=_FRAME_RATE, size=film.size)
            else:
                for _ in frames:
                    pass
            record = self.episode.record
            if folder is not None:
                folder.finish(record)
        self.retries = _retries(station) - before
        return record

    def _begin(self) -> None:
        setup, place = self.station.setup, self.episode.draw_place(self._starts)
        if self.options.log_folder is None:
            self.episode.begin(place, random_push(setup, place.X_WO, self._pushes))
        else:
            X_WO = start_of_log(self.options.log_folder, setup)
            self.episode.begin(place if X_WO is None else Place(X_WO, place.p_WP))

    def _frames(
        self, progress: SessionProgress, film: Film | None, folder: EpisodeFolder | None
    ) -> Iterator[np.ndarray]:
        """Simulate; yield the frames of the film, if there is one, and add images to the folder, if there is one."""
        longest, number = self.episode.longest(self.options.duration), 0
        for t in self.episode.advance(self.options.duration):
            rate = t / max(self.episode.wall_time, 1e-9)
            words = f"{t:.2f} of {longest:.2f} s at most, {rate:.2f} x real time"
            progress(self.station.engine.name, t / longest, words)
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


def simulate(scene: Scene, options: SessionOptions | None = None) -> Record:
    """Pushes the object of a scene once in a station.

    Args:
        scene: A setup, a scenario, the name or path of one, or the folder of a twin; see `load_setup`.
        options: Engine, push, duration, and files to write, whose folders are made if need be; None for a straight push
            in the scene's own engine.

    Returns:
        The motion of object and pusher.

    Raises:
        PinwmError: The scene or an option cannot be used, or a file cannot be written.
    """
    options = options or SessionOptions()
    for path in (options.out, options.video, options.record):
        if path is not None:
            prepare_folder(path.parent)
    return Session(load_setup(scene), options).first()


def _retries(station: SceneStation) -> int:
    """Return the number of the twin's steps that had to be made shorter; plants know nothing of the kind."""
    return 0 if station.world is None else station.world.physics.retries
