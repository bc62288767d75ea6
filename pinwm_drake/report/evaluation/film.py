# SPDX-License-Identifier: MIT
"""Pictures of an evaluation's episodes: one episode after some actions, and many side by side as a film."""

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from functools import cache

import numpy as np
import trimesh
from matplotlib.colors import to_rgb

from pinwm_drake.report.camera import ViewCamera
from pinwm_drake.report.captions import write_caption
from pinwm_drake.report.evaluation.episode import EpisodeRecord, rotation
from pinwm_drake.report.evaluation.figures import OUTCOMES
from pinwm_drake.report.outline import boundary, silhouette
from pinwm_drake.report.scene import Actor, Stage
from pinwm_drake.report.style import evenly
from pinwm_drake.spatial.poses import Pose

Lines = list[tuple[np.ndarray, tuple[float, float, float]]]
_GOAL, _PUSHER = (0.02, 0.42, 0.10), (0.10, 0.25, 0.55)  # linear RGB
_BAND = 24  # px, height of the title
_BORDER, _STAYS = 3, 8  # px, and pictures that the end of a film shows


@dataclass(eq=False)
class EpisodeFilm:
    """Pictures of episodes of one scene by one camera."""

    camera: ViewCamera
    floor_height: float  # m, world
    actors: Sequence[Actor]  # the object's surfaces, frame O
    mesh: trimesh.Trimesh  # the object, m, frame O
    pusher: trimesh.Trimesh  # m, frame P
    # The object's pose at an episode's goal, of which height does not count; None where any of many will do.
    X_WG: Callable[[EpisodeRecord], Pose | None]

    def __post_init__(self) -> None:
        self._stage = Stage(self.camera, self.floor_height)
        self._pusher = Actor.from_mesh(self.pusher, _PUSHER, smooth=True)
        self._goals: dict[tuple[float, ...], Lines] = {}

    def picture(self, record: EpisodeRecord, step: int) -> np.ndarray:
        """Picture of an episode after some actions, or at its end: (height, width, 3) uint8, sRGB."""
        k = min(step, record.last)
        R_WO, p_WO = rotation(record.q_WO[k]).as_matrix(), record.p_WO[k]
        actors = [(actor, R_WO, p_WO) for actor in self.actors]
        return self._stage.picture([*actors, (self._pusher, np.eye(3), record.p_WP[k])], self._goal(record))

    def _goal(self, record: EpisodeRecord) -> Lines:
        key = tuple(record.goal.tolist())
        if key not in self._goals:
            X_WG, outline = self.X_WG(record), np.zeros((0, 2, 2))
            if X_WG is not None:
                rotated = rotation(X_WG.q.numpy()).as_matrix()
                outline = boundary(*silhouette(self.mesh, rotated)) + X_WG.p[:2].numpy()
            self._goals[key] = [(segment, _GOAL) for segment in outline]
        return self._goals[key]

    def captioned(self, record: EpisodeRecord, step: int) -> np.ndarray:
        """Picture with seed and number of the action; at the end in a frame of the outcome's colour."""
        result, ended = record.result, step >= record.last
        image = self.picture(record, step)
        words = f"{result.seed}: {min(step, record.last)}"
        write_caption(image, f"{words} {result.outcome}" if ended else words)
        b, colour = (_BORDER, to_rgb(OUTCOMES[result.outcome])) if ended else (1, to_rgb("white"))
        image[:b] = image[-b:] = image[:, :b] = image[:, -b:] = np.rint(255 * np.array(colour)).astype(np.uint8)
        return image


class FilmGrid:
    """Episodes side by side from their first action on, one or more; one that has ended stays as it is.

    Attributes:
        size: (width, height) px, even.
        steps: Actions of the longest episode.
        kept: Numbers of actions, at equal distances, whose pictures are kept once they are drawn.
    """

    def __init__(
        self,
        film: EpisodeFilm,
        records: Sequence[EpisodeRecord],
        columns: int = 4,
        *,
        keep: int = 40,
        title: str = "",
    ) -> None:
        self._film, self._records = film, list(records)
        self._columns = min(columns, len(self._records))
        rows = -(-len(self._records) // self._columns)
        width = self._columns * film.camera.width // 2 * 2
        self._band = np.full((_BAND if title else 0, width, 3), 255, np.uint8)
        if title:
            write_caption(self._band, title)
        self.size = (width, len(self._band) + rows * film.camera.height // 2 * 2)
        self.steps = max(record.last for record in self._records)
        self.kept = evenly(self.steps + 1, keep)
        self._last = cache(lambda k: film.captioned(self._records[k], self.steps))
        self._drawn: dict[int, np.ndarray] = {}

    def picture(self, step: int) -> np.ndarray:
        """Picture of all episodes after some actions: (height, width, 3) uint8, sRGB."""
        if step in self._drawn:
            return self._drawn[step]
        tiles = [
            self._film.captioned(record, step) if step < record.last else self._last(k)
            for k, record in enumerate(self._records)
        ]
        tiles += [np.full_like(tiles[0], 255)] * (-len(tiles) % self._columns)
        rows = [np.hstack(tiles[k : k + self._columns]) for k in range(0, len(tiles), self._columns)]
        grid = np.vstack(rows)[: self.size[1] - len(self._band), : self.size[0]]
        picture = np.ascontiguousarray(np.vstack([self._band, grid]))
        if step in self.kept:
            self._drawn[step] = picture
        return picture

    def pictures(self) -> Iterator[np.ndarray]:
        """Pictures of the film: one for each action, and some more of the end."""
        for step in range(self.steps + 1 + _STAYS):
            yield self.picture(min(step, self.steps))
