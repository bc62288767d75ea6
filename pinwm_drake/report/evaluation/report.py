"""The report of an evaluation: one page that loads nothing from anywhere."""

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import Any

import numpy as np

from pinwm_drake.files import replacing
from pinwm_drake.learning.evaluation import EpisodeResult, Evaluation
from pinwm_drake.report.embed import figure_uri, picture_uri
from pinwm_drake.report.evaluation.episode import EpisodeRecord
from pinwm_drake.report.evaluation.figures import start_figure, steps_figure, success_figure
from pinwm_drake.report.evaluation.film import EpisodeFilm, FilmGrid
from pinwm_drake.report.evaluation.film_strip import film_player
from pinwm_drake.report.page import figure, fill_template, paragraph, section, table, text, tree

_GOOD, _FAIR = 0.98, 0.8  # success rates of the verdict's colours
_MOST_FAILED, _SLOWEST = 12, 4  # episodes in the gallery
_STRIP, _MOST_FRAMES = 6, 30  # pictures of an episode, and of the film
_COLUMNS = (
    *(
        ("seed", "number"),
        ("outcome", "key"),
        ("actions", "number"),
        ("distance [mm]", "number"),
        ("angle [°]", "number"),
    ),
    *(("start x [mm]", "number"), ("y [mm]", "number"), ("yaw [°]", "number"), ("", "wide")),
)


@dataclass(frozen=True, eq=False)
class EvaluationStory:
    """Contents of the report of an evaluation.

    Attributes:
        title: Title of the page.
        about: Policy, scene and engine in a line.
        records: The episodes, 1 or more.
        max_steps: Actions after which an episode ended.
        horizon: Time that an action takes, s.
        q_WO: (4,) wxyz, orientation of the lying object at yaw 0.
        settings: Plain data: scene, engine, tolerances and the like.
        provenance: Plain data: the policy, its training, versions.
        film: Pictures of the episodes.
        shown: Number of episodes that the film shows.
    """

    title: str
    about: str
    records: Sequence[EpisodeRecord]
    max_steps: int
    horizon: float
    q_WO: tuple[float, float, float, float]
    settings: Mapping[str, Any]
    provenance: Mapping[str, Any]
    film: EpisodeFilm
    shown: int = 16

    @property
    def evaluation(self) -> Evaluation:
        """Figures of the evaluation: success rate, steps, distances."""
        return Evaluation(tuple(record.result for record in self.records))

    @cached_property
    def grid(self) -> FilmGrid:
        """Film of the first episodes, side by side."""
        return FilmGrid(self.film, self.records[: self.shown], keep=_MOST_FRAMES)


def write_evaluation_report(
    path: Path, story: EvaluationStory, report: Callable[[float], None] = lambda share: None
) -> None:
    """Writes the report of an evaluation.

    Args:
        path: File of the report; its folder exists.
        story: Contents of the report.
        report: Called with the share of the pictures that is done.

    Raises:
        InputError: The file cannot be written.
    """
    parts = {
        "title": text(story.title),
        "about": text(story.about),
        "notices": "",
        "body": "\n".join((_verdict(story.evaluation), *_sections(story, report))),
    }
    with replacing(path) as temporary:
        temporary.write_text(fill_template(parts), encoding="utf-8")


def headline(evaluation: Evaluation) -> str:
    """The success rate in words, with its interval."""
    low, high = evaluation.interval
    rate = f"{100 * evaluation.success_rate:.1f} % (95 % interval {100 * low:.1f} to {100 * high:.1f} %, Wilson)"
    return f"{evaluation.successes} of {evaluation.episodes} episodes succeeded: {rate}"


def details(evaluation: Evaluation) -> list[str]:
    """Steps, distances and failures in words, one line each."""
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


def _verdict(evaluation: Evaluation) -> str:
    rate = evaluation.success_rate
    status = "good" if rate >= _GOOD else "fair" if rate >= _FAIR else "poor"
    lines = "".join(f"<li>{text(line)}</li>" for line in details(evaluation))
    return f'<div class="verdict {status}"><p>{text(headline(evaluation))}</p><ul>{lines}</ul></div>'


def _sections(story: EvaluationStory, report: Callable[[float], None]) -> list[str]:
    evaluation, steps = story.evaluation, story.max_steps
    curve, histogram = success_figure(evaluation, steps), steps_figure(evaluation, steps)
    starts = start_figure(story.records, story.q_WO)
    return [
        section(
            "How soon",
            figure(figure_uri(curve), "Share of the episodes that had succeeded after so many actions."),
            figure(figure_uri(histogram), "Actions that episodes took."),
        ),
        section(
            "From where",
            figure(
                figure_uri(starts), "Where the object began, with the direction of its x axis, and what came of it."
            ),
        ),
        _gallery(story),
        section("The first episodes", *_film(story, report)),
        section("Episodes", table(_COLUMNS, [_row(record, story.q_WO) for record in story.records])),
        section("Settings", tree(story.settings)),
        section("Provenance", tree(story.provenance)),
    ]


def _film(story: EvaluationStory, report: Callable[[float], None]) -> list[str]:
    grid, pictures = story.grid, []
    for number, step in enumerate(grid.kept):
        words = f"after {step} actions, {step * story.horizon:.1f} s"
        pictures.append((step * story.horizon, grid.picture(step), words))
        report((number + 1) / len(grid.kept))
    words = "Seed and number of the action; the goal's outline is green. A frame says how an episode ended. The video "
    words += "beside this page has every action."
    return [film_player(pictures), paragraph(words)]


def _gallery(story: EvaluationStory) -> str:
    """Strips of the episodes that failed, or of the slowest ones where none did."""
    failed = [record for record in story.records if not record.result.success]
    if failed:
        chosen, title = failed[:_MOST_FAILED], "Episodes that failed"
        more = len(failed) - len(chosen)
        words = f"The first {len(chosen)} of {len(failed)}; the table has the others." if more else ""
    else:
        chosen = sorted(story.records, key=lambda record: -record.result.steps)[:_SLOWEST]
        title, words = "The slowest episodes", "None failed."
    parts = [paragraph(words)] if words else []
    for record in chosen:
        parts.append(f"<h3>{text(_words(record.result))}</h3>")
        parts.append(_strip(story.film, record))
    return section(title, *parts)


def _strip(film: EpisodeFilm, record: EpisodeRecord) -> str:
    """Strip of the scene at a few times and, where the policy sees images, of those below."""
    chosen = record.at.tolist() if len(record.at) else strip_steps(record.last)
    cells = ["<span></span>", *(f"<span>{step} actions</span>" for step in chosen), "<span>scene</span>"]
    cells += [_image(film.picture(record, step), f"scene after {step} actions") for step in chosen]
    if len(record.at):
        cells.append("<span>policy's<br>image</span>")
        cells += [_image(view, f"image after {step} actions") for view, step in zip(record.views, chosen, strict=True)]
    columns = f"grid-template-columns: auto repeat({len(chosen)}, minmax(0, 1fr))"
    return f'<div class="strips" style="{columns}">{"".join(cells)}</div>'


def strip_steps(last: int) -> list[int]:
    """Numbers of actions, 0 to `last`, after which the pictures of a strip are taken."""
    return [int(step) for step in np.unique(np.linspace(0, last, _STRIP).round())]


def _image(picture: np.ndarray, words: str) -> str:
    return f'<img src="{picture_uri(picture)}" alt="{text(words)}">'


def _words(result: EpisodeResult) -> str:
    words = f"seed {result.seed}: {result.outcome} after {result.steps} actions"
    where = f"{1e3 * result.distance:.1f} mm and {math.degrees(result.angle):.1f}° from the goal"
    return f"{words}, {where}" + (f" ({result.failure})" if result.failure else "")


def _row(record: EpisodeRecord, q_WO: tuple[float, float, float, float]) -> list[str]:
    result, (x, y, yaw) = record.result, record.start(q_WO)
    kind = "yes" if result.success else "no"
    return [
        str(result.seed),
        f'<span class="{kind}">{text(result.outcome)}</span>',
        str(result.steps),
        f"{1e3 * result.distance:.1f}",
        f"{math.degrees(result.angle):.1f}",
        f"{1e3 * x:.1f}",
        f"{1e3 * y:.1f}",
        f"{math.degrees(yaw):.1f}",
        text(result.failure),
    ]
