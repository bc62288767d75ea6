# SPDX-License-Identifier: MIT
"""A small scene for tests of `pinwm evaluate`, and what one writes."""

import csv
import json
from pathlib import Path

SCENARIO = """
units: {length: m, mass: kg, time: s, angle: rad}
name: small push
object: t_block
theta: {mass: 1.0, friction_floor: 0.1, friction_pusher: 0.1, restitution: 0.0}
pusher: {max_speed: 0.3, low: [-0.3, -0.3, 0.01], high: [0.3, 0.3, 0.2]}
physics: {time_step: 0.008333333333333333}
camera: {width: 32, height: 32}
start: {x: [-0.02, 0.02], y: [-0.02, 0.02], yaw: [-0.3, 0.3]}
"""


def write_scenario(folder: Path) -> str:
    """The path of the scene."""
    path = folder / "small.scenario.yaml"
    path.write_text(SCENARIO)
    return str(path)


def rows(out: Path) -> list[dict[str, str]]:
    return list(csv.DictReader((out / "episodes.csv").open()))


def document(out: Path) -> dict:
    return json.loads((out / "evaluation.json").read_text())
