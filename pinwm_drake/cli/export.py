"""`pinwm export`: options, and the contents of the bundle in a few lines."""

import time
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, TypeAlias

import typer

from pinwm_drake.cli.console import say

if TYPE_CHECKING:
    from pinwm_drake.learning.bundle import Bundle

_Corner: TypeAlias = tuple[float, float, float] | None
_LIMITS = "Limits"
_CALLS = 100  # calls of the network that are timed


def export(
    policy: Annotated[Path, typer.Argument(metavar="POLICY", help="Folder that `pinwm train` wrote; of images.")],
    bundle: Annotated[Path, typer.Argument(metavar="BUNDLE", help="New or empty folder.")],
    scene: Annotated[
        str | None,
        typer.Option(
            help="Where the golden samples are seen: a scenario's name or path, or a twin's folder.",
            show_default="that of the policy's task and object",
        ),
    ] = None,
    seed: Annotated[int, typer.Option(help="Of where these episodes start, 0 or more.")] = 0,
    max_speed: Annotated[
        float | None, typer.Option(help="m/s. Default: what the policy was trained with.", rich_help_panel=_LIMITS)
    ] = None,
    max_acceleration: Annotated[
        float | None,
        typer.Option(help="m/s^2. Default: from one way to the other in an action.", rich_help_panel=_LIMITS),
    ] = None,
    max_image_age: Annotated[
        float | None, typer.Option(help="s. Default: the duration of two actions.", rich_help_panel=_LIMITS)
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
    from pinwm_drake.experiments.golden_samples import export_bundle

    limits = {
        "max_speed": max_speed,
        "max_acceleration": max_acceleration,
        "max_image_age": max_image_age,
        "box_low": box_low,
        "box_high": box_high,
    }
    given = {name: value for name, value in limits.items() if value is not None}
    for line in _described(export_bundle(policy, bundle, scene=scene, seed=seed, limits=given), bundle):
        say(line)


def _described(bundle: "Bundle", folder: Path) -> list[str]:
    """Lines on a bundle: limits, golden samples, the time of a call, and files."""
    import numpy as np

    golden, limits, task = bundle.provenance["golden"], bundle.limits, bundle.spec.task
    acting = bundle.toward([0.0] * task.goal_size) if task.goal_size else bundle
    image, axes = np.full(bundle.spec.image_shape, 255, np.uint8), task.axis_indices
    p_WP = 0.5 * np.add(limits.box_low, limits.box_high)[axes]
    seconds = []
    for _ in range(_CALLS):
        start = time.perf_counter()
        acting.act(image, p_WP)
        seconds.append(time.perf_counter() - start)
    low, high = (" ".join(f"{value:g}" for value in corner) for corner in (limits.box_low, limits.box_high))
    return [
        f"limits: {limits.max_speed:.3g} m/s, {limits.max_acceleration:.3g} m/s^2, image no older than "
        f"{limits.max_image_age:g} s, pusher within {low} to {high} m",
        f"{golden['samples']} golden samples; onnxruntime is {golden['deviation_from_torch']:.1e} m from torch at most",
        f"{1e3 * np.median(seconds):.2f} ms a call on one core",
        *(f"wrote {path} ({path.stat().st_size / 1e3:.1f} kB)" for path in sorted(folder.iterdir())),
        f"SHA-256 of the bundle: {bundle.sha256}",
    ]
