"""Pose of the block after the push in the three engines: a check that they do the same work.

The push is nearly along the line of the centre of mass, which is unstable: the turn of the block is what
tells contact models apart. A hard contact, a soft one (MuJoCo) and one with a margin (Bullet) cannot agree to
the last millimetre. The second table turns the whole scene about z, which changes nothing with a round friction cone.
"""

import math

from benchmarks import push, results, timing

timing.limit_threads(1)  # before numba and torch are imported

import numpy as np

from benchmarks.bullet_scene import BulletPush
from benchmarks.mujoco_scene import MujocoPush
from benchmarks.pinwm_scene import PinwmPush

_ENGINES = {
    "pinwm_drake": PinwmPush,
    "MuJoCo, pyramidal cone (default)": MujocoPush,
    "MuJoCo, elliptic cone": lambda pusher: MujocoPush(pusher, elliptic=True),
    "Bullet": BulletPush,
}
_HEADINGS = (0.0, 11.25, 22.5)  # degrees


def _pose(trace: dict) -> dict[str, float]:
    """Final pose of a trace: x, y, z in mm and yaw in degrees."""
    x, y, z = (1e3 * value for value in trace["p"])
    return {"x": x, "y": y, "z": z, "yaw": math.degrees(push.yaw(trace["q"]))}


def _turned(heading: float) -> dict[str, float]:
    """Final pose of a push with the sphere in a turned scene, turned back."""
    trace = PinwmPush("sphere", heading=math.radians(heading)).trace()
    c, s = math.cos(math.radians(heading)), math.sin(math.radians(heading))
    trace["p"] = np.array([[c, s, 0.0], [-s, c, 0.0], [0.0, 0.0, 1.0]]) @ trace["p"]
    pose = _pose(trace)
    return {**pose, "yaw": pose["yaw"] - heading}


def table(data: dict) -> str:
    """Table of the figures, in Markdown."""
    lines = [
        "| pusher | engine | x, mm | y, mm | z, mm | yaw, degrees |",
        "| --- | --- | --- | --- | --- | --- |",
    ]
    for pusher, poses in data["pushers"].items():
        for name, pose in poses.items():
            x, y, z, yaw = pose["x"], pose["y"], pose["z"], pose["yaw"]
            lines.append(f"| {pusher} | {name} | {x:.1f} | {y:.1f} | {z:.2f} | {yaw:.1f} |")
    headings = [f"{heading:g}°: x, mm; yaw, degrees" for heading in _HEADINGS]
    cells = [f"{pose['x']:.1f}; {pose['yaw']:.1f}" for pose in data["headings"]]
    lines += ["", f"| {' | '.join(headings)} |", "| --- " * len(headings) + "|", f"| {' | '.join(cells)} |"]
    return "\n".join(lines)


def main() -> None:
    """Measures and reports the figures."""
    given = results.arguments(__doc__ or "").parse_args()
    pushers = {
        pusher: {name: _pose(engine(pusher).trace()) for name, engine in _ENGINES.items()} for pusher in push.PUSHERS
    }
    data = {"pushers": pushers, "headings": [_turned(heading) for heading in _HEADINGS]}
    results.publish("accuracy", data, table(data), given.write)


if __name__ == "__main__":
    main()
