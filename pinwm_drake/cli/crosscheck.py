# SPDX-License-Identifier: MIT
"""`pinwm crosscheck`: a bar of the pushes, a table, and one line for each verdict."""

from rich.console import Console

from pinwm_drake.cli.console import say, stages_bar
from pinwm_drake.errors import InputError
from pinwm_drake.files import prepare_folder
from pinwm_drake.systems.crosscheck.options import CrossCheckRequest

_FAILED = 1  # exit code
_WIDTH = 100  # characters, of a table that goes to a file


def crosscheck(request: CrossCheckRequest) -> None:
    """Compare a twin with Drake's contact on the same pushes.

    Exits with 0 for PASS and with 1 for FAIL.
    """
    from pinwm_drake.geometry.primitive import acting_words
    from pinwm_drake.kernel_cache import announce_compiling
    from pinwm_drake.report.twin.data import read_ground_truth
    from pinwm_drake.systems.crosscheck.crosscheck import crosscheck
    from pinwm_drake.systems.scenario.load import load_setup
    from pinwm_drake.tasks.registry import recipe_of

    options, truth, out = request.resolved(), request.truth, request.out
    setup = load_setup(request.twin)
    known = None if truth is None else read_ground_truth(truth)
    if truth is not None and not known:
        raise InputError(truth, value="no parameter of a twin", allowed="mass, friction_floor, restitution, ...")
    if out is not None:
        prepare_folder(out)
    question = f"{setup.scenario.name}: the plants have "
    if truth is None:
        question += "the twin's own parameters; this checks its physics, not its parameters"
    else:
        question += f"the parameters of {truth}; this checks the twin's physics and parameters"
    say(question)
    say(f"the object acts as {acting_words(setup.twin.acts_as)}")
    motions, done = recipe_of(setup.task).check, 0
    announce_compiling()
    with stages_bar(transient=True) as show:

        def moved() -> None:
            nonlocal done
            done += 1
            show(motions, done / options.pushes, f"{done}/{options.pushes}")

        show(motions, 0.0, f"0/{options.pushes}")
        found = crosscheck(setup, options, truth=known, report=moved)
    console = Console() if Console().is_terminal else Console(width=_WIDTH)
    if (table := found.table()) is not None:
        console.print(table)
    for line in found.words():
        say(line)
    for passed, words in found.results():
        colour, word = ("green", "PASS") if passed else ("red", "FAIL")
        console.print(f"[bold {colour}]{word}[/] {words}", highlight=False, soft_wrap=True)
    if out is not None:
        for path in found.write(out, setup, question):
            say(f"wrote {path}")
    if not found.passed:
        raise SystemExit(_FAILED)
