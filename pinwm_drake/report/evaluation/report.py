# SPDX-License-Identifier: MIT
"""The report of an evaluation: one page that loads nothing from anywhere."""

import math
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property, partial
from pathlib import Path
from typing import Any

from pinwm_drake.learning.evaluation import Evaluation
from pinwm_drake.report.evaluation.episode import EpisodeRecord
from pinwm_drake.report.evaluation.figures import start_figure, steps_figure, success_figure
from pinwm_drake.report.evaluation.film import EpisodeFilm, FilmGrid
from pinwm_drake.report.page import Frame, write_page
from pinwm_drake.report.style import evenly

_GOOD, _FAIR = 0.98, 0.8  # success rates of the verdict's colours
_MOST_FAILED, _SLOWEST = 12, 4  # episodes in the gallery
_STRIP, _MOST_FRAMES = 6, 30  # pictures of an episode, and of the film


@dataclass(frozen=True, eq=False)
class EvaluationStory:
    """Contents of the report of an evaluation."""

    title: str
    about: str  # policy, scene and engine in a line
    records: Sequence[EpisodeRecord]  # 1 or more
    max_steps: int  # actions after which an episode ended
    horizon: float  # s, that an action takes
    q_WO: tuple[float, float, float, float]  # wxyz, of the lying object at yaw 0
    settings: Mapping[str, Any]  # plain data: scene, engine, tolerances and the like
    provenance: Mapping[str, Any]  # plain data: the policy, its training, versions
    film: EpisodeFilm
    shown: int = 16  # episodes in the film

    @property
    def evaluation(self) -> Evaluation:
        """Figures of the evaluation: success rate, steps, distances."""
        return Evaluation(tuple(record.result for record in self.records))

    @cached_property
    def grid(self) -> FilmGrid:
        """Film of the first episodes, side by side."""
        return FilmGrid(self.film, self.records[: self.shown], keep=_MOST_FRAMES, title=self.title)


def write_evaluation_report(
    path: Path, story: EvaluationStory, report: Callable[[float], None] = lambda share: None
) -> None:
    """Write the report of an evaluation; `report` is called with the share of the pictures that is done.

    Raises:
        InputError: The file cannot be written.
    """
    evaluation = story.evaluation
    failed = [record for record in story.records if not record.result.success]
    slowest = sorted(story.records, key=lambda record: -record.result.steps)
    rate = evaluation.success_rate
    write_page(
        path,
        "report/evaluation/report.html",
        story=story,
        status="good" if rate >= _GOOD else "fair" if rate >= _FAIR else "poor",
        headline=headline(evaluation),
        details=details(evaluation),
        success=success_figure(evaluation, story.max_steps),
        steps=steps_figure(evaluation, story.max_steps),
        starts=start_figure(story.records, story.q_WO),
        failed=len(failed),
        gallery=failed[:_MOST_FAILED] or slowest[:_SLOWEST],
        strip=partial(_strip, story.film),
        film=list(_film(story, report)),
        degrees=math.degrees,
    )


def headline(evaluation: Evaluation) -> str:
    """Return the success rate in words, with its interval."""
    low, high = evaluation.interval
    rate = f"{100 * evaluation.success_rate:.1f} % (95 % interval {100 * low:.1f} to {100 * high:.1f} %, Wilson)"
    return f"{evaluation.successes} of {evaluation.episodes} episodes succeeded: {rate}"


def details(evaluation: Evaluation) -> list[str]:
    """Return steps, distances and failures in words, one line each."""
    summary = evaluation.summary()
    steps, lines = summary["steps"], []
    if evaluation.successes:
        mean, median = steps["successes"]["mean"], steps["successes"]["median"]
        lines.append(f"successes took {mean:.1f} actions on average, {median:g} in the median")
    lines.append(
        f"all episodes took {steps['all']['mean']:.1f} actions on average, {steps['all']['median']:g} in the median"
    )
    distance, angle = summary["final_distance"]["median"], summary["final_angle"]["median"]
    if distance is not None and angle is not None:
        lines.append(f"in the end the object was {1e3 * distance:.1f} mm and {math.degrees(angle):.1f}° away, median")
    covered = summary["coverage"]["mean"]
    if covered is not None:
        near = summary["within_10_mm_and_0.1_rad"]
        lines.append(
            f"it then covered {100 * covered:.1f} % of the goal's outline on average; {near} within 10 mm, 0.1 rad"
        )
    if summary["time_limits"]:
        lines.append(f"{summary['time_limits']} ran into the time limit")
    if summary["failures"]:
        lines.append(f"in {summary['failures']} the physics failed; that counts as no success")
    return lines


def _film(story: EvaluationStory, report: Callable[[float], None]) -> Iterator[Frame]:
    grid = story.grid
    for number, step in enumerate(grid.kept):
        t = step * story.horizon
        yield t, grid.picture(step), f"after {step} actions, {t:.1f} s"
        report((number + 1) / len(grid.kept))


def _strip(film: EpisodeFilm, record: EpisodeRecord) -> dict[str, list[Any]]:
    chosen = record.at.tolist() if len(record.at) else strip_steps(record.last)
    rows = [[(film.picture(record, step), f"scene after {step} actions") for step in chosen]]
    if len(record.at):
        rows.append([(view, f"image after {step} actions") for view, step in zip(record.views, chosen, strict=True)])
    return {"rows": rows, "heads": [f"{step} actions" for step in chosen]}


def strip_steps(last: int) -> list[int]:
    """Numbers of actions, 0 to `last`, after which the pictures of a strip are taken."""
    return evenly(last + 1, _STRIP)
