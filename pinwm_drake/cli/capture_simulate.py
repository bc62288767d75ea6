"""`pinwm capture simulate`: options, and a bar of the images."""

from pathlib import Path
from typing import Annotated

import typer

from pinwm_drake.cli.console import say, stages_bar
from pinwm_drake.tasks import DEFAULT_TASK


def simulate(
    out: Annotated[Path, typer.Argument(metavar="OUT", help="Folder of the capture; new, or empty.")],
    object_name: Annotated[
        str, typer.Option("--object", help="t_block, large_t, cube, mug or mug_handle.")
    ] = "t_block",
    task: Annotated[
        str,
        typer.Option(help="push, or flip: pokes that make a cube, or a mug that lies, slide and rock without a flip."),
    ] = DEFAULT_TASK,
    friction: Annotated[float, typer.Option(help="Friction coefficient of object and floor.")] = 0.03,
    pusher_friction: Annotated[
        float | None,
        typer.Option(help="Friction coefficient of object and pusher.", show_default="that of --friction"),
    ] = None,
    mass: Annotated[float, typer.Option(help="Of the object, in kg.")] = 1.0,
    restitution: Annotated[
        float, typer.Option(help="Share of the speed after an impact; only roughly kept above 0.")
    ] = 0.0,
    seed: Annotated[int, typer.Option(help="Of the object's place, the pushes and the cameras.")] = 0,
    size: Annotated[int, typer.Option(help="Width and height of the images, in px.")] = 400,
    episodes: Annotated[int, typer.Option(help="How many pushes, each from the same pose of the object.")] = 2,
    static_views: Annotated[int, typer.Option(help="How many images of the object at rest.")] = 24,
    frames: Annotated[int, typer.Option(help="Images of each push.")] = 48,
    rate: Annotated[float, typer.Option(help="Images a second.")] = 24.0,
    speed: Annotated[
        float | None,
        typer.Option(help="Of the pusher, in m/s.", show_default="one at which the object coasts on by 12 mm"),
    ] = None,
    rise: Annotated[tuple[float, float], typer.Option(help="Least and most of a poke's way over level, in rad.")] = (
        0.3,
        0.8,
    ),
    distance: Annotated[float, typer.Option(help="That it goes on after it has met the object, in m.")] = 0.10,
    pusher: Annotated[str, typer.Option(help="Its shape: sphere, capsule or cylinder.")] = "sphere",
    pusher_radius: Annotated[float, typer.Option(help="In m.")] = 0.01,
    lying: Annotated[bool, typer.Option("--lying", help="The mug lies on its side.")] = False,
    realistic: Annotated[
        bool,
        typer.Option(
            "--realistic",
            help="As a lab has it: uneven object, one lamp, blur, ragged masks; start, cameras and clock a bit off.",
        ),
    ] = False,
    stand_in: Annotated[
        bool,
        typer.Option(
            "--stand-in",
            help="As a lab has it, of the object and in the light of `pinwm evaluate --stand-in`.",
        ),
    ] = False,
    forces: Annotated[
        bool,
        typer.Option("--forces", help="Logs the object's force on the pusher, and leaves the mass for it to tell."),
    ] = False,
    supersampling: Annotated[int, typer.Option(help="Rendered pixels for each of an image, along each side.")] = 3,
) -> None:
    """Makes a capture from Drake: a stand-in for a robot that pushes an object in front of a camera."""
    from pinwm_drake.systems.runs.simulated_capture import SimulateOptions, simulate_capture

    options = SimulateOptions(
        task=task,
        object_name=object_name,
        friction=friction,
        pusher_friction=friction if pusher_friction is None else pusher_friction,
        mass=mass,
        restitution=restitution,
        seed=seed,
        size=size,
        episodes=episodes,
        static_views=static_views,
        frames=frames,
        rate=rate,
        speed=speed,
        rise=rise,
        distance=distance,
        pusher=pusher,
        pusher_radius=pusher_radius,
        lying=lying,
        supersampling=supersampling,
        realistic=realistic,
        forces=forces,
        stand_in=stand_in,
    )
    with stages_bar() as progress:
        simulate_capture(options, out, progress=progress)
    say(f"wrote {out}")
