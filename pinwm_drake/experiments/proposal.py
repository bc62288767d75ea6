# SPDX-License-Identifier: MIT
"""A proposed push in words and in files: which one it is, why, and what it is expected to tell."""

import math
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import trimesh

from pinwm_drake.capture.write import write_trajectory
from pinwm_drake.documents import yaml_text
from pinwm_drake.experiments.next_push import Candidate, Proposal, trajectory_of
from pinwm_drake.files import replacing
from pinwm_drake.geometry.meshes import load_mesh, mass_properties
from pinwm_drake.report.figures.next_push import next_push_figure
from pinwm_drake.spatial.poses import Pose, pose_to_matrix
from pinwm_drake.systems.pusher.motion import StraightPush
from pinwm_drake.twin.twin import Twin

_CENTRAL, _STRAIGHT = 2e-3, 20.0  # m from the centre of mass, and deg from an axis, that are not told apart
_TOLD = 0.9  # of the spread of a parameter: what leaves more has not told much


@dataclass(frozen=True)
class Expectation:
    """Expectation of what a push tells of a parameter: its 95 % interval now, and about that after the push."""

    parameter: str
    interval: tuple[float, float]
    after: tuple[float, float]


def expectations(twin: Twin, candidate: Candidate) -> list[Expectation]:
    """Return what a push is expected to tell of each parameter with an interval, that which gains most first."""
    found = []
    for name, share in sorted(candidate.remaining.items(), key=lambda item: item[1]):
        estimate = twin.theta.get(name)
        if estimate is None:
            continue
        if estimate.interval is not None and 0.0 < estimate.interval[0] < estimate.interval[1] < math.inf:
            value = min(max(estimate.value, estimate.interval[0]), estimate.interval[1])
            low, high = (value * (end / value) ** share for end in estimate.interval)
            found.append(Expectation(name, estimate.interval, (low, high)))
    return found


def describe(twin: Twin, proposal: Proposal) -> list[str]:
    """Return the proposal in sentences: whether a push is needed, which one, and what it is expected to tell."""
    best, (position, turn) = proposal.candidates[0], proposal.spread
    motion = best.motion
    mesh_W = load_mesh(twin.mesh_path)
    mesh_W.apply_transform(pose_to_matrix(proposal.X_WO).numpy())
    level = motion.direction_W[:2]
    rise = math.degrees(math.atan2(motion.direction_W[2], np.hypot(*level)))
    verb, up = ("poke", f" and {rise:.0f}° upwards") if rise > 0.0 else ("push", "")
    direction, place = level / np.hypot(*level), mass_properties(mesh_W, mass=1.0).p_com[:2] - motion.p_WP[:2]
    aside = float(direction[1] * place[0] - direction[0] * place[1])  # of the line of the push, to the left of the mass
    start = ", ".join(f"{1e3 * x:.0f}" for x in motion.p_WP)
    limits = f"{1e3 * proposal.tolerance[0]:g} mm and {math.degrees(proposal.tolerance[1]):g}°"
    lines = [
        f"where the object comes to rest is predicted to {1e3 * position:.1f} mm and {math.degrees(turn):.1f}° "
        f"(standard deviation, nine of ten random pushes); good enough are {limits}",
        "a push would hardly change what the twin predicts"
        if proposal.is_good_enough
        else "so a push is worth filming",
        f"with the object at {_pose_words(proposal.X_WO)}, {verb} the side that faces {_side(mesh_W, motion)}: "
        f"from ({start}) mm towards {_heading(direction)}{up}, for {1e3 * motion.distance:.0f} mm "
        f"at {1e3 * motion.speed:.0f} mm/s",
    ]
    if abs(aside) > _CENTRAL:
        side, way = ("left", "clockwise") if aside > 0 else ("right", "anticlockwise")
        lines.append(
            f"the pusher passes {1e3 * abs(aside):.0f} mm to the {side} of the centre of mass: "
            f"the object turns {way}, seen from above"
        )
    if proposal.amplified:
        lines.append(
            f"{proposal.amplified} of {len(proposal.candidates)} pushes come last: a start that is off by a millimetre "
            "decides their end"
        )
    if proposal.deciding is not None:
        lines.append(f"whether it turns over depends on {proposal.deciding}, which this poke tells best")
    told = expectations(twin, best)
    if told and best.remaining[told[0].parameter] < _TOLD:
        one = told[0]
        (low, high), (least, most) = one.interval, one.after
        lines.append(
            f"its video tells most about {one.parameter}: 95 % interval {low:.3g} to {high:.3g} now, "
            f"about {least:.3g} to {most:.3g} afterwards"
        )
    else:
        lines.append("its video is expected to narrow no parameter's interval by much")
    if proposal.confusion is not None:
        left = 1e3 * 1.96 * proposal.confusion.spread * best.remaining["frame"]
        lines.append(f"{proposal.confusion.reason}; after it the frame is expected to be known there to ±{left:.1f} mm")
    lines.append(
        f"the twin's draws differ by {1e3 * best.position:.1f} mm and {math.degrees(best.yaw):.1f}° in where it ends; "
        f"{best.information:.1f} nats of information, the median of {len(proposal.candidates)} pushes is "
        f"{_median(proposal):.1f}"
    )
    return lines


def _pose_words(X_WO: Pose) -> str:
    w, x, y, z = (float(value) for value in X_WO.q)
    yaw = math.degrees(math.atan2(2.0 * (w * z + x * y), 1.0 - 2.0 * (y * y + z * z)))
    return f"({1e3 * float(X_WO.p[0]):.0f}, {1e3 * float(X_WO.p[1]):.0f}) mm and yaw {yaw + 0.0:.0f}°"


def _side(mesh_W: trimesh.Trimesh, motion: StraightPush) -> str:
    """Return the direction that the surface faces where the line of a push meets it first; its back where it misses."""
    start, direction = motion.p_WP, motion.direction_W
    corner, a, b = mesh_W.triangles[:, 0], *(mesh_W.triangles[:, k] - mesh_W.triangles[:, 0] for k in (1, 2))
    # Möller and Trumbore: barycentric coordinates of the point, and the way to it, for every triangle.
    cross = np.cross(direction, b)
    with np.errstate(divide="ignore", invalid="ignore"):
        scale = 1.0 / np.einsum("ij,ij->i", a, cross)
        away = start - corner
        u = np.einsum("ij,ij->i", away, cross) * scale
        other = np.cross(away, a)
        v, way = other @ direction * scale, np.einsum("ij,ij->i", b, other) * scale
        met = (u >= -1e-9) & (v >= -1e-9) & (u + v <= 1.0 + 1e-9) & (way > 0.0)
    if not met.any():
        return _heading(-direction[:2])
    return _heading(mesh_W.face_normals[np.where(met, way, np.inf).argmin()][:2])


def _heading(direction: np.ndarray) -> str:
    """Return a direction (2,) in the plane as an angle from +x towards +y, with the axis that it is near to."""
    angle = math.degrees(math.atan2(direction[1], direction[0])) % 360.0
    nearest = ("+x", "+y", "-x", "-y")[round(angle / 90.0) % 4]
    return (
        f"{nearest} ({angle:.0f}°)"
        if abs((angle + 45.0) % 90.0 - 45.0) < _STRAIGHT
        else f"{angle:.0f}° (0° is +x, 90° is +y)"
    )


def write_proposal(folder: Path, twin: Twin, proposal: Proposal) -> list[Path]:
    """Write the best push: `push.yaml`, the pusher's `trajectory.csv`, and a picture, `next_push.png`.

    Args:
        folder: Folder that is there.
        twin: The twin.
        proposal: The pushes.

    Returns:
        The files.

    Raises:
        InputError: A file cannot be written.
    """
    best = proposal.candidates[0]
    motion, (position, yaw) = best.motion, proposal.spread
    document = {
        "push": {
            "start": [float(x) for x in motion.p_WP],
            "direction": [float(x) for x in motion.direction_W],
            "speed": float(motion.speed),
            "distance": float(motion.distance),
            "units": "m, m/s, world frame",
        },
        "information": {"nats": best.information, "median_of_candidates": _median(proposal)},
        "spread": {"position": position, "yaw": yaw, "of": "nine of ten random pushes, standard deviation, m and rad"},
        "expected": [
            {"parameter": one.parameter, "interval": list(one.interval), "after": list(one.after)}
            for one in expectations(twin, best)
        ],
        "good_enough": proposal.is_good_enough,
    }
    path = folder / "push.yaml"
    with replacing(path) as temporary:
        temporary.write_text(yaml_text(document), encoding="utf-8")
    write_trajectory(folder / "trajectory.csv", trajectory_of(motion))
    motions = [one.motion for one in proposal.candidates]
    next_push_figure(
        folder / "next_push.png",
        load_mesh(twin.mesh_path),
        proposal.X_WO,
        best.X_WO,
        starts=np.array([motion.p_WP[:2] for motion in motions]),
        ends=np.array([(motion.p_WP + motion.distance * motion.direction_W)[:2] for motion in motions]),
        informations=np.array([one.information for one in proposal.candidates]),
        spreads=np.array([one.position for one in proposal.candidates]),
    )
    return [path, folder / "trajectory.csv", folder / "next_push.png"]


def _median(proposal: Proposal) -> float:
    return float(np.median([one.information for one in proposal.candidates]))
