"""`pinwm simulate`: its options. The work is in `simulate_run`."""

from pathlib import Path
from typing import Annotated

import typer


def simulate(
    scenario: Annotated[
        str | None,
        typer.Argument(
            metavar="SCENARIO",
            help="A .scenario.yaml file, the name of one that ships, such as push_t, or the folder of a twin.",
            show_default=False,
        ),
    ] = None,
    engine: Annotated[
        str | None, typer.Option(help="twin, hydroelastic or point.", show_default="that of the scenario")
    ] = None,
    twin: Annotated[
        Path | None, typer.Option(help="Folder of a twin, in place of the scenario's object.", show_default="none")
    ] = None,
    seed: Annotated[
        int | None, typer.Option(help="Of the start and of the push.", show_default="that of the scenario")
    ] = None,
    duration: Annotated[
        float | None, typer.Option(help="Simulated time, in s.", show_default="until the object rests")
    ] = None,
    push: Annotated[
        str, typer.Option(help="straight, for one through the object, or a trajectory.csv to be replayed.")
    ] = "straight",
    meshcat: Annotated[
        bool, typer.Option("--meshcat", help="Show it in the browser, in real time, push after push until Ctrl-C.")
    ] = False,
    host: Annotated[
        str, typer.Option(help="Address for --meshcat to listen on; others than this let other machines in.")
    ] = "localhost",
    port: Annotated[int | None, typer.Option(help="Port to listen on.", show_default="first free from 7000")] = None,
    record: Annotated[
        Path | None, typer.Option(help="Write what Meshcat shows as one .html file that needs no server.")
    ] = None,
    video: Annotated[
        Path | None, typer.Option(help="Film the scene, and beside it the port `rgb`, to this .mp4 file.")
    ] = None,
    out: Annotated[
        Path | None,
        typer.Option(
            "--out", "-o", help="Folder, new or empty, for an episode as captures have it: poses, pusher's log, images."
        ),
    ] = None,
) -> None:
    """Pushes an object in a station, whatever moves it: the learned twin, or Drake's contact models."""
    from pinwm_drake.cli.simulate_options import SimulateOptions
    from pinwm_drake.cli.simulate_run import run_simulate

    options = SimulateOptions(
        engine=engine,
        seed=seed,
        duration=duration,
        push=push,
        meshcat=meshcat,
        host=host,
        port=port,
        record=record,
        video=video,
        out=out,
    )
    run_simulate(scenario, twin, options)
