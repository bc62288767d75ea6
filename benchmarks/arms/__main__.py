# SPDX-License-Identifier: MIT
"""Episodes of a bundle by a simulated arm over LCM, in lockstep: success, faults, and room to the joints' limits.

    python -m benchmarks.arms BUNDLE OUT.jsonl [--arm panda] [--latency 0.08] [--episodes 100] [--start 1000]

Each episode is that of `pinwm control BUNDLE --arm --simulate-arm --arm-model ARM --latency S --seed N`: its messages,
limits and faults are those of a robot behind LCM, within one process, whose time does not run on while it computes.
OUT.jsonl has a line for each episode; those that it has already are not run again.
"""

import argparse
import json
import logging
import math
from pathlib import Path

import numpy as np

from benchmarks import timing

if __name__ == "__main__":
    timing.limit_threads(1)  # before numba and torch are imported

from pinwm_drake.learning.bundle import Bundle, read_bundle
from pinwm_drake.systems.arm.model import ARMS, JOINTS, ArmName
from pinwm_drake.systems.control.loop import ControlLoop
from pinwm_drake.systems.envs.options import EnvOptions, environment_setup
from pinwm_drake.systems.envs.policy_scene import FORCE, policy_setup
from pinwm_drake.systems.scenario.load import with_url
from pinwm_drake.systems.scenario.schema import MEMORY
from pinwm_drake.systems.scenario.setup import Setup


def episode(bundle: Bundle, setup: Setup, arm: ArmName, latency: float, seed: int) -> dict[str, object]:
    """Figures of one episode: success, number of actions, fault, and the joints' least room and largest speed.

    Args:
        bundle: The policy.
        setup: Its scene, with LCM in memory.
        arm: Name of the arm.
        latency: s, of the camera.
        seed: Seed of the start.
    """
    loop = ControlLoop(bundle, bundle.limits, setup, "lcm", armed=True, simulate_arm=True, arm=arm, latency=latency)
    driver = loop.driver
    assert driver is not None
    plant, rooms, speeds = driver.model.plant, [], []
    loop.begin(loop.draw_place(np.random.default_rng(seed)))
    loop.listen()

    def look() -> str:
        mine = driver.GetMyContextFromRoot(loop.simulator.get_context())
        q, v = np.split(driver.GetOutputPort("arm_state").Eval(mine), [JOINTS])
        rooms.append(float(np.minimum(q - plant.GetPositionLowerLimits(), plant.GetPositionUpperLimits() - q).min()))
        speeds.append(float((np.abs(v) / plant.GetVelocityUpperLimits()).max()))
        return ""

    rows = list(loop.advance(bundle.spec.max_steps * bundle.spec.horizon, stop=look))
    loop.stop()
    row = rows[-1]
    return {
        "seed": seed,
        "success": row.success,
        "actions": len(rows) - 1,
        "fault": row.status.reason if row.status.state == "latched" else "",
        "at the end, m": round(row.distance, 4),
        "at the end, deg": round(math.degrees(row.angle), 1),
        "room of a joint, rad": round(min(rooms), 4),
        "joint speed of its limit": round(max(speeds), 4),
    }


def main() -> None:
    """Run the episodes that are missing, and print a summary."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("bundle", help="folder that `pinwm export` wrote")
    parser.add_argument("out", type=Path, help="file of the episodes")
    parser.add_argument("--arm", choices=list(ARMS), default="panda")
    parser.add_argument("--latency", type=float, default=0.08, help="of the camera, s")
    parser.add_argument("--episodes", type=int, default=100)
    parser.add_argument("--start", type=int, default=1000, help="seed of the first episode")
    given = parser.parse_args()
    logging.getLogger("drake").setLevel(logging.ERROR)
    bundle = read_bundle(given.bundle)
    setup = policy_setup(bundle.spec, bundle.provenance, given.bundle, None, FORCE)
    setup = with_url(environment_setup(setup, EnvOptions(image_size=bundle.spec.camera.width)), MEMORY, None)
    run = {"bundle": bundle.sha256, "arm": given.arm, "latency, s": given.latency}
    rows = [json.loads(line) for line in given.out.read_text().splitlines()] if given.out.exists() else []
    if any({key: row[key] for key in run} != run for row in rows):
        parser.error(f"{given.out}: got episodes of another bundle, arm or latency; allowed: a new file")
    seeds = range(given.start, given.start + given.episodes)
    rows = [row for row in rows if row["seed"] in seeds]
    done = {row["seed"] for row in rows}
    for seed in seeds:
        if seed not in done:
            rows.append(run | episode(bundle, setup, given.arm, given.latency, seed))
            with given.out.open("a") as file:
                file.write(json.dumps(rows[-1]) + "\n")
            print(rows[-1], flush=True)
    good = [row for row in rows if row["success"]]
    room, speed = min(row["room of a joint, rad"] for row in rows), max(row["joint speed of its limit"] for row in rows)
    print(
        f"{given.arm}, {1e3 * given.latency:.0f} ms: {len(good)} of {len(rows)}, "
        f"{np.mean([row['actions'] for row in rows]):.1f} actions; {sum(bool(row['fault']) for row in rows)} faults; "
        f"room of a joint {room:.3f} rad, joint speed {100 * speed:.0f} % of its limit"
    )


if __name__ == "__main__":
    main()
