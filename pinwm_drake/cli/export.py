"""`pinwm export`: its options. The work is in `export_run`."""

from pathlib import Path
from typing import Annotated, TypeAlias

import typer

_Corner: TypeAlias = tuple[float, float, float] | None
_LIMITS = "Limits"


def export(
    policy: Annotated[Path, typer.Argument(metavar="POLICY", help="Folder that `pinwm train` wrote; of images.")],
    bundle: Annotated[Path, typer.Argument(metavar="BUNDLE", help="New or empty folder.")],
    scene: Annotated[
        str, typer.Option(help="Where the golden samples are seen: a scenario's name or path, or a twin's folder.")
    ] = "push_t",
    seed: Annotated[int, typer.Option(help="Of where these episodes start, 0 or more.")] = 0,
    max_speed: Annotated[
        float | None, typer.Option(help="m/s. Default: what the policy was trained with.", rich_help_panel=_LIMITS)
    ] = None,
    max_acceleration: Annotated[
        float | None,
        typer.Option(help="m/s^2. Default: from one way to the other in an action.", rich_help_panel=_LIMITS),
    ] = None,
    max_image_age: Annotated[
        float | None, typer.Option(help="s. Default: the duration of an action.", rich_help_panel=_LIMITS)
    ] = None,
    box_low: Annotated[
        _Corner,
        typer.Option(
            metavar="X Y Z",
            help="m, least coordinates of the pusher. Default: those of training, and 10 mm below its height.",
            rich_help_panel=_LIMITS,
        ),
    ] = None,
    box_high: Annotated[
        _Corner,
        typer.Option(
            metavar="X Y Z",
            help="m, largest coordinates. Default: those of training, and 10 mm above its height.",
            rich_help_panel=_LIMITS,
        ),
    ] = None,
) -> None:
    """Makes a bundle of a policy: network in ONNX, contract, limits, golden samples; onnxruntime alone runs it."""
    from pinwm_drake.cli.export_run import run_export

    limits = {
        "max_speed": max_speed,
        "max_acceleration": max_acceleration,
        "max_image_age": max_image_age,
        "box_low": box_low,
        "box_high": box_high,
    }
    given = {name: value for name, value in limits.items() if value is not None}
    run_export(policy, bundle, scene=scene, seed=seed, limits=given)
