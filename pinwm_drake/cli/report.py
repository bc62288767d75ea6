# SPDX-License-Identifier: MIT
"""`pinwm report`: a bar, and the verdict in a few lines."""

from rich.console import Console

from pinwm_drake.cli.console import say, stages_bar
from pinwm_drake.experiments.requests.twins import ReportRequest


def report(request: ReportRequest) -> None:
    """Write the report of a twin: one page that needs no network.

    It shows parameters, pictures, film, motion, course of the search and provenance.
    """
    from pinwm_drake.files import prepare_folder
    from pinwm_drake.report.twin.data import read_story
    from pinwm_drake.report.twin.report import write_twin_report

    story = read_story(request.twin, request.capture)
    prepare_folder(request.path.parent)
    with stages_bar(transient=True) as show:
        verdict = write_twin_report(request.path, story, lambda share: show("drawing", share, ""))
    for line in (f"{verdict.headline}.", *verdict.lines):
        say(line)
    errors = Console(stderr=True, soft_wrap=True)
    errors = Console(stderr=True, soft_wrap=True)
    for notice in story.notices:
        errors.print(f"note: {notice}", highlight=False, markup=False)
    say(f"wrote {request.path}")
