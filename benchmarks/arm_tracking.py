# SPDX-License-Identifier: MIT
"""How closely the tool of a simulated arm follows commands of random directions, and whether its joints keep limits.

    python -m benchmarks.arm_tracking [--arm ARM] [--speeds V ...] [--acceleration A] [--plane] [--seconds S]

The scene is flip_mug, without touch. A command of the given speed holds for 0.1 s; its direction is drawn such that it
ends within x, y of the arm's reach and z of 0.014 to 0.2 m. The error is the tool's distance, at the end of a command,
from where the driver's limits of speed and acceleration let it be.
"""

import argparse
import dataclasses

from benchmarks import timing

if __name__ == "__main__":
    timing.limit_threads(1)  # before numba and torch are imported

import numpy as np

from benchmarks.results import markdown
from pinwm_drake.systems.arm.check import CommandedArm
from pinwm_drake.systems.arm.model import ARMS, ArmName
from pinwm_drake.systems.scenario.load import load_setup

ACTION = 0.1  # s: a command holds
LOW, HIGH = 0.014, 0.2  # m, of z
COLUMNS = "speed | rms | 95 % | max | joint speed | room of a joint's angle | rod's tilt, rms | max | outside its box"


def track(arm: ArmName, speed: float, seconds: float, plane: bool, seed: int = 0) -> list[str]:
    """Row of the table: how an arm follows random commands of a speed [m/s], in the plane of x and z only or in any."""
    driven, generator = CommandedArm(load_setup("flip_mug"), arm), np.random.default_rng(seed)
    driven.begin(np.array([-0.1, 0.0, 0.1]))
    driver = driven.driver
    low, high = np.array(driver.limits.box_low), np.minimum(driver.limits.box_high, [np.inf, np.inf, HIGH])
    low[2] = max(low[2], LOW)
    errors, tilts, period = [], [], driver.setup.scenario.lcm.period

    def look() -> None:
        tilts.append(np.degrees(np.arccos(min(driver.tool_pose(driven.context).rotation().matrix()[2, 2], 1.0))))

    for _ in range(round(seconds / ACTION)):
        driven.act(_drawn(generator, driven.target[:3], speed, low, high, plane), ACTION, look)
        # The target is that of the last period.
        errors.append(np.linalg.norm(driven.tool[:3] - driven.target[:3] - period * driven.target[3:]))
    states, joints = (log.FindLog(driven.context).data().T for log in driven.logs)
    plant = driver.model.plant
    q, share = joints[:, :7], np.abs(joints[:, 7:]) / plant.GetVelocityUpperLimits()
    room = np.minimum(q - plant.GetPositionLowerLimits(), plant.GetPositionUpperLimits() - q).min()
    p = states[:, :3]
    outside = max(float((driver.limits.box_low - p).max()), float((p - driver.limits.box_high).max()), 0.0)
    squares = [float(np.sqrt(np.mean(np.square(values)))) for values in (errors, tilts)]
    return [
        f"{speed:g} m/s",
        f"{1e3 * squares[0]:.1f} mm",
        f"{1e3 * np.percentile(errors, 95):.1f} mm",
        f"{1e3 * max(errors):.1f} mm",
        f"{100 * share.max():.0f} % of the limit",
        f"{room:.2f} rad",
        f"{squares[1]:.0f}°",
        f"{max(tilts):.0f}°",
        f"{1e3 * outside:.1f} mm",
    ]


def _drawn(
    generator: np.random.Generator, p: np.ndarray, speed: float, low: np.ndarray, high: np.ndarray, plane: bool
) -> np.ndarray:
    """Velocity (3,) m/s of a random direction that stays within a box for an action, or of the way to its middle."""
    for _ in range(200):
        way = generator.normal(size=3) * ([1.0, 0.0, 1.0] if plane else 1.0)
        velocity = speed * way / np.linalg.norm(way)
        end = p + ACTION * velocity
        if (low < end).all() and (end < high).all():
            return np.asarray(velocity)
    way = 0.5 * (low + high) - p
    return np.asarray(speed * way / np.linalg.norm(way))


def main() -> None:
    """Print the table."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--arm", choices=list(ARMS), default="panda")
    parser.add_argument("--speeds", type=float, nargs="+", default=[0.2, 0.5, 1.0, 1.25], help="m/s")
    parser.add_argument("--acceleration", type=float, help="m/s^2, of the tool; the arm's own without")
    parser.add_argument("--plane", action="store_true", help="directions in the plane of x and z only, as of pokes")
    parser.add_argument("--seconds", type=float, default=60.0, help="s, at each speed")
    options = parser.parse_args()
    if options.acceleration is not None:
        ARMS[options.arm] = dataclasses.replace(ARMS[options.arm], max_acceleration=options.acceleration)
    rows = [track(options.arm, speed, options.seconds, options.plane) for speed in options.speeds]
    print("\n".join(markdown(COLUMNS, rows)))


if __name__ == "__main__":
    main()
