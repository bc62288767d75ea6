"""`pinwm control` and `pinwm arm`: their options. The work is in `control_run` and `arm_run`."""

from typing import Annotated

import typer

_SCENE = "A scenario that ships, a .scenario.yaml file, or the folder of a twin."
_URL = "Address of LCM: udpm://ADDRESS:PORT?ttl=0, which stays within this machine."
_CONTACT = "Of the simulated arm: hydroelastic, or point, which takes half the time."


def control(
    bundle: Annotated[
        str, typer.Argument(metavar="BUNDLE", help="Folder that `pinwm export` wrote, or the name of one that ships.")
    ],
    scene: Annotated[str, typer.Option(help=_SCENE)] = "push_t",
    engine: Annotated[
        str, typer.Option(help="What is controlled: hydroelastic, point or twin, or a robot behind lcm.")
    ] = "hydroelastic",
    arm: Annotated[
        bool, typer.Option("--arm/--dry-run", help="Move the pusher; or only show what the policy would do.")
    ] = False,
    simulate_arm: Annotated[
        bool, typer.Option("--simulate-arm", help="Simulate an arm behind lcm in this process; needs no robot.")
    ] = False,
    contact: Annotated[str, typer.Option(help=_CONTACT)] = "hydroelastic",
    duration: Annotated[float, typer.Option(help="s, at most, 0.1 to 600; it ends at the goal.")] = 20.0,
    seed: Annotated[int, typer.Option(help="Of where object and pusher start, 0 or more; not of a robot's.")] = 0,
    lcm_url: Annotated[str | None, typer.Option(help=_URL, show_default="that of the scenario")] = None,
    meshcat: Annotated[
        bool, typer.Option("--meshcat", help="Show it in the browser, on this machine, in real time.")
    ] = False,
    port: Annotated[
        int | None, typer.Option(help="Port of Meshcat to listen on.", show_default="first free from 7000")
    ] = None,
) -> None:
    """Lets a bundle control a station: a simulation, or a robot over LCM. Without --arm nothing moves."""
    from pinwm_drake.cli.control_run import ControlOptions, run_control

    options = ControlOptions(
        scene=scene,
        engine="lcm" if simulate_arm else engine,
        arm=arm,
        simulate_arm=simulate_arm,
        contact=contact,
        duration=duration,
        seed=seed,
        lcm_url=lcm_url,
        meshcat=meshcat,
        port=port,
    )
    run_control(bundle, options)


def arm(
    scene: Annotated[str, typer.Option(help=_SCENE)] = "push_t",
    image_size: Annotated[
        int | None, typer.Option(help="px, of images, as the policy sees them.", show_default="that of the scene")
    ] = None,
    contact: Annotated[str, typer.Option(help=_CONTACT)] = "point",
    duration: Annotated[float, typer.Option(help="s, 0.1 to 3600.")] = 60.0,
    seed: Annotated[int, typer.Option(help="Of where object and pusher start, 0 or more.")] = 0,
    lcm_url: Annotated[str | None, typer.Option(help=_URL, show_default="that of the scenario")] = None,
    meshcat: Annotated[bool, typer.Option("--meshcat", help="Show it in the browser, on this machine.")] = False,
    port: Annotated[
        int | None, typer.Option(help="Port of Meshcat to listen on.", show_default="first free from 7000")
    ] = None,
) -> None:
    """Simulates an arm in real time for `pinwm control --engine lcm` in another terminal."""
    from pinwm_drake.cli.arm_run import ArmOptions, run_arm

    options = ArmOptions(
        scene=scene,
        image_size=image_size,
        contact=contact,
        duration=duration,
        seed=seed,
        lcm_url=lcm_url,
        meshcat=meshcat,
        port=port,
    )
    run_arm(options)
