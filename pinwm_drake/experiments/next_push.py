# SPDX-License-Identifier: MIT
"""Choice of the next push: the one of many that would tell most about what a twin does not know yet.

Under the draws of a twin the poses that a push would be seen in have a covariance C, and those that would be seen of
one object a noise K: that of the drift and of the images. The video is expected to tell

    I = ln det(1 + K^-1 C) / 2

of theta, as for Gaussians. What the draws differ by where the object comes to rest, for the whole set of random pushes,
tells whether there is still a need.

Pokes rock or turn the object. Where one friction decides whether the tasks of pokes can be done, and is not known well
enough, the poke comes first that tells most about it.

Source: Chaloner and Verdinelli, "Bayesian experimental design: a review", Statistical Science 10(3), 1995, section 2.
"""

import math
import warnings
from collections.abc import Callable
from dataclasses import dataclass
from typing import TypeVar

import numpy as np
import torch
import trimesh

from pinwm_drake.capture.episode_tables import Motion, PusherTrajectory
from pinwm_drake.capture.episodes import read_episode
from pinwm_drake.capture.pusher import pushing_height, upright_shape
from pinwm_drake.capture.scene import Capture, PusherShape, load_capture
from pinwm_drake.cousins.domain import CousinDomains
from pinwm_drake.errors import ParameterError, PinwmError, SolverError, require
from pinwm_drake.geometry.meshes import half_diagonal, load_mesh, mass_properties
from pinwm_drake.identification.discrepancy import prior_root
from pinwm_drake.identification.expansion import deviation
from pinwm_drake.physics.parameters import Parameters
from pinwm_drake.scene import Scene, resting_height
from pinwm_drake.spatial.poses import Pose, pose_to_matrix
from pinwm_drake.systems.pusher.choice import choose_poke, choose_push
from pinwm_drake.systems.pusher.motion import StraightPush
from pinwm_drake.tasks.registry import recipe_of, task_names
from pinwm_drake.twin.drift import typical_drift
from pinwm_drake.twin.frame import Confusion, confusion, drawn_frames, moved_pose, pivot_of
from pinwm_drake.twin.origin import Origin
from pinwm_drake.twin.rollout import drawn_parameters, rollout_kicks, rollout_worlds, twin_parameters, twin_scene
from pinwm_drake.twin.twin import THETA, Twin

_SPEEDS, _DISTANCES = (0.05, 0.3), (0.06, 0.11)  # m/s, drawn evenly by their logarithm; m, after the touch
_LONGEST = 2.0  # s, of a motion
_AFTERWARDS = {"push": 0.4, "poke": 0.8}  # s, of video after the pusher stops
_FRAME_RATE, _LOG_RATE = 24.0, 240.0  # Hz
_MUCH = 0.5  # of the most information: what a push tells that is chosen for one unknown
_KNOWN = CousinDomains.delta  # relative half-width of an interval up to which cousins cover it
_Read = TypeVar("_Read")
_ATTEMPTS = 20  # for each candidate that is to stay in the box and to be seen
_ASIDE = (5e-4, math.radians(0.5))  # m, rad: by which a start is moved aside
_ASIDES, _STEADY = 8, 3.0  # draws for that; by how much the end may be farther aside than the start
_TOWARDS = 0.5  # cosine, of the angle between a push and the way to the camera, from which the object hides the pusher


@dataclass(frozen=True, eq=False)
class Candidate:
    """A push that could be next.

    Attributes:
        motion: Motion of the pusher.
        information: Information that a video of it is expected to give, nats.
        position, yaw: Standard deviations by the draws where the object comes to rest, m (in the plane) and rad.
        remaining: Share of the standard deviation of each parameter's logarithm that is expected to remain, by name;
            with "frame", of the robot's frame where draws do not tell it apart from the centre of mass.
        X_WO: Poses of the object by the draws at the end: q (W, 4), p (W, 3) [m].
        amplification: By how much farther aside the object ends than it starts, median over some draws.
    """

    motion: StraightPush
    information: float
    position: float
    yaw: float
    remaining: dict[str, float]
    X_WO: Pose
    amplification: float = 1.0

    @property
    def is_steady(self) -> bool:
        """Flag: a start aside is not made so large that nobody predicts the end."""
        return self.amplification <= _STEADY


@dataclass(frozen=True, eq=False)
class Proposal:
    """Pushes that could be next, and how much a twin still does not know.

    Attributes:
        candidates: The pushes, those first that would tell most.
        X_WO: Pose of the object before a push, q (4,), p (3,) [m].
        tolerance: Spread that is good enough: m, rad.
        confusion: Direction in which frame and centre of mass are not told apart; None where they are.
        deciding: Friction that the first poke is chosen for; None where none is chosen so.
    """

    candidates: list[Candidate]
    X_WO: Pose
    tolerance: tuple[float, float]
    confusion: Confusion | None = None
    deciding: str | None = None

    @property
    def spread(self) -> tuple[float, float]:
        """Standard deviations that nine of ten random pushes stay below: m, rad."""
        values = np.array([[one.position, one.yaw] for one in self.candidates])
        position, yaw = np.quantile(values, 0.9, axis=0)
        return float(position), float(yaw)

    @property
    def amplified(self) -> int:
        """Number of pushes that come last, as they make a start aside too large."""
        return sum(not one.is_steady for one in self.candidates)

    @property
    def is_good_enough(self) -> bool:
        """Flag: the spread is within the tolerance, so that a further push would hardly change predictions."""
        return all(found <= allowed for found, allowed in zip(self.spread, self.tolerance, strict=True))


def next_push(
    twin: Twin,
    *,
    X_WO: Pose | None = None,
    motion: Motion = "push",
    low: tuple[float, float] = (-math.inf, -math.inf),
    high: tuple[float, float] = (math.inf, math.inf),
    eye: np.ndarray | None = None,
    number: int = 48,
    draws: int = 32,
    tolerance: tuple[float, float] = (2e-3, math.radians(2.0)),
    seed: int = 0,
    report: Callable[[float], None] = lambda share: None,
) -> Proposal:
    """Proposes the push that would tell most about a twin.

    Args:
        twin: A twin with draws.
        X_WO: Pose of the object before the push, q (4,), p (3,) [m]; None for that of the capture that the twin is from
            where that is at hand, else upright at the origin.
        motion: "push" for level pushes, "poke" for short and fast ones that go up.
        low, high: Corners of the pusher's box in the world's x and y, m.
        eye: (3,) m, place of the camera that films the push: none goes towards it, where the object hides the pusher.
        number: Number of random pushes that are looked at.
        draws: Number of the twin's draws that each is rolled out with, at the most.
        tolerance: Spread of nine of ten random pushes that is good enough, m and rad.
        seed: Seed of the pushes.
        report: Called with the share of the pushes that are done.

    Returns:
        The pushes, those first that would tell most. Level pushes that make a start aside more than three times as
        large come after the others: nobody predicts how they end. Before them comes one of much information: where
        frame and centre of mass are not told apart, the push that does so best; of pokes, the one that tells most
        about the friction that decides (`deciding_friction`).

    Raises:
        ParameterError: The twin has no draws, a number is out of range, or no push stays in the box and in sight.
        PinwmError: A mesh cannot be used.
    """
    require("number", number, 1 <= number <= 10000, "1 to 10000")
    require("draws", draws, 2 <= draws <= 1000, "2 to 1000")
    if eye is not None:
        require("eye", eye, np.shape(eye) == (3,) and bool(np.isfinite(eye).all()), "3 finite numbers, m")
    if twin.draws is None:
        raise ParameterError(f"{twin.name}: the twin has no draws; identify it anew with this release")
    X_WO = X_WO or start_of(twin)
    scene = twin_scene(twin, X_WO.q)
    mesh_W = load_mesh(twin.mesh_path)
    radius, walk = half_diagonal(mesh_W), typical_drift(twin)
    X_WO = Pose(X_WO.q, torch.cat([X_WO.p[:2], torch.tensor([resting_height(scene, X_WO.q)], dtype=torch.float64)]))
    mesh_W.apply_transform(pose_to_matrix(X_WO).numpy())
    rows = twin.draws.rows(draws)
    # What is of one push alone tells nothing of the object.
    parameters = drawn_parameters(twin, scene, rows, anew=False)
    # Pushes take errors of velocities back.
    own = twin_parameters(twin, scene) if motion == "poke" else None
    logarithms, confused = _logarithms(twin, rows), confusion(twin.draws, X_WO.q)
    frames = drawn_frames(twin, rows), pivot_of(twin)
    if confused is not None:
        along = frames[0][:, 0] * math.cos(confused.angle) + frames[0][:, 1] * math.sin(confused.angle)
        logarithms["frame"] = along - along.mean()
    generator = np.random.default_rng(seed)
    shape, p_com = upright_shape(twin.pusher), mass_properties(mesh_W, mass=1.0).p_com
    candidates = []
    for k in range(number):
        drawn = _draw(motion, mesh_W, p_com, shape, generator, twin.floor_height, (low, high), eye)
        try:
            candidates.append(_look(scene, parameters, own, frames, X_WO, drawn, logarithms, radius, walk))
        except SolverError:
            continue  # a push whose physics fails is none to propose
        report((k + 1) / number)
    if not candidates:
        raise SolverError("the physics found no solution for any push; identify the twin with a smaller time step")
    candidates.sort(key=lambda one: (not one.is_steady, -one.information))
    unknown = "frame" if confused is not None else deciding_friction(twin) if motion == "poke" else None
    if unknown is not None and unknown not in candidates[0].remaining:
        unknown = None  # all draws have the same value
    if unknown is not None:
        first = candidates[0]
        alike = [one for one in candidates if one.is_steady == first.is_steady]
        enough = [one for one in alike if one.information >= _MUCH * first.information]
        best = min(enough, key=lambda one: one.remaining[unknown])
        candidates.sort(key=lambda one: one is not best)
    return Proposal(candidates, X_WO, tolerance, confused, None if confused is not None else unknown)


def deciding_friction(twin: Twin) -> str | None:
    """Friction that decides whether tasks of pokes can be done and is known least; None where cousins cover all."""
    names = {name for task in task_names() if recipe_of(task).motion == "poke" for name in recipe_of(task).possible}
    wide = {}
    for name in sorted(names & twin.theta.keys()):
        value, ends = twin.theta[name].value, twin.theta[name].interval
        if ends is not None and value > 0.0:
            wide[name] = max(value - ends[0], ends[1] - value) / value
    unknown = max(wide, key=lambda name: wide[name], default=None)
    return unknown if unknown is not None and wide[unknown] > _KNOWN else None


def filmed_motion(twin: Twin) -> Motion:
    """Motion of the episodes that a twin was identified from; "push", with a warning, where they are not at hand."""
    motions = _filmed(twin, _motions, "pushes are level", "--motion poke proposes pokes") or []
    return "poke" if "poke" in motions else "push"


def start_of(twin: Twin) -> Pose:
    """Pose of the object in a twin's capture; upright at the origin, with a warning, where that is not at hand."""
    one = torch.tensor([1.0, 0.0, 0.0, 0.0], dtype=torch.float64)
    seen = _filmed(twin, lambda capture, origin: capture.object.X_WO, "the object starts upright at the origin")
    return seen or Pose(one, torch.zeros(3, dtype=torch.float64))


def _motions(capture: Capture, origin: Origin) -> list[Motion]:
    return [read_episode(capture, name).trajectory.motion for name in origin.episodes]


def _filmed(twin: Twin, read: Callable[[Capture, Origin], _Read], instead: str, remedy: str = "") -> _Read | None:
    """What the capture of a twin says; None, with a warning of what is taken instead, where it is not at hand."""
    origin = Origin.read(twin)
    try:
        if origin is not None:
            return read(load_capture(origin.path), origin)
        why = "it does not say which capture it is from"
    except PinwmError as error:
        why = f"its capture cannot be read ({error})"
    warnings.warn("; ".join(filter(None, [f"{twin.name}: {why}", instead, remedy])), UserWarning, stacklevel=3)
    return None


def trajectory_of(motion: StraightPush) -> PusherTrajectory:
    """Log of a pusher that makes a motion, from its start until the object has had time to rest."""
    afterwards = _AFTERWARDS["poke" if motion.direction_W[2] > 0.0 else "push"]
    t = np.arange(math.ceil((motion.end_time + afterwards) * _LOG_RATE) + 1) / _LOG_RATE
    travels = np.array([motion.travel(float(time)) for time in t])
    p_WP = motion.p_WP + travels[:, :1] * motion.direction_W
    return PusherTrajectory(
        t, p_WP, np.tile([1.0, 0.0, 0.0, 0.0], (len(t), 1)), travels[:, 1:] * motion.direction_W, None
    )


def _draw(
    kind: Motion,
    mesh_W: trimesh.Trimesh,
    p_com: np.ndarray,
    shape: PusherShape,
    generator: np.random.Generator,
    floor_height: float,
    box: tuple[tuple[float, float], tuple[float, float]],
    eye: np.ndarray | None,
) -> StraightPush:
    for _ in range(_ATTEMPTS):
        motion = (
            choose_poke(mesh_W, p_com, shape, generator, floor_height=floor_height)
            if kind == "poke"
            else _level_push(mesh_W, p_com, shape, generator, floor_height)
        )
        ends = np.stack([motion.p_WP, motion.p_WP + motion.distance * motion.direction_W])[:, :2]
        if (ends >= box[0]).all() and (ends <= box[1]).all() and not _hides(motion, eye):
            return motion
    allowed = "a box with room to push the object" + ("" if eye is None else f", not towards the camera at {eye} m")
    raise ParameterError(f"low, high: got {box[0]} and {box[1]} m; allowed: {allowed}")


def _hides(motion: StraightPush, eye: np.ndarray | None) -> bool:
    """Flag: a push goes towards a camera at `eye` (3,) [m], so that the object hides the pusher."""
    if eye is None:
        return False
    way, direction = (eye - motion.p_WP)[:2], motion.direction_W[:2]
    return bool(way @ direction > _TOWARDS * np.linalg.norm(way) * np.linalg.norm(direction))


def _level_push(
    mesh_W: trimesh.Trimesh,
    p_com: np.ndarray,
    shape: PusherShape,
    generator: np.random.Generator,
    floor_height: float,
) -> StraightPush:
    speed = math.exp(generator.uniform(*np.log(_SPEEDS)))
    distance = min(generator.uniform(*_DISTANCES), speed * _LONGEST)
    wanted = floor_height + generator.uniform(0.4, 1.0) * (p_com[2] - floor_height)
    height = pushing_height(shape, floor_height, wanted)
    return choose_push(mesh_W, p_com, shape, generator, height=height, speed=speed, distance=distance)


def _logarithms(twin: Twin, rows: np.ndarray) -> dict[str, torch.Tensor]:
    """Logarithms (W,) of the parameters that the draws of a twin differ in, less their mean, by name."""
    assert twin.draws is not None
    found = {}
    for name in THETA:
        values = twin.draws.column(name)[rows] if name in twin.draws.names else np.zeros(0)
        if len(values) and (values > 0.0).all() and values.std() > 1e-9 * values.mean():
            logarithm = torch.from_numpy(np.log(values))
            found[name] = logarithm - logarithm.mean()
    return found


def _look(
    scene: Scene,
    parameters: Parameters,
    own: Parameters | None,
    frames: tuple[torch.Tensor, torch.Tensor],
    X_WO: Pose,
    motion: StraightPush,
    logarithms: dict[str, torch.Tensor],
    radius: float,
    walk: tuple[float, float],
) -> Candidate:
    """Information and spread of a push of an object with a radius [m], by its drift; see `drift.typical_drift`.

    Parameters are those of the draws, and the twin's own where errors of velocities count.
    """
    trajectory = trajectory_of(motion)
    t = np.arange(0.0, trajectory.t[-1], 1.0 / _FRAME_RATE)
    found = rollout_worlds(scene, parameters, X_WO, trajectory, t, frames)
    middle = Pose(found.q[:, 0], found.p.mean(1))
    d = deviation(found, Pose(middle.q[:, None], middle.p[:, None]))
    d = d - d.mean(1, keepdim=True)
    n, W, _ = d.shape
    carried = None if own is None else rollout_kicks(scene, own, X_WO, trajectory, t)
    root = prior_root(middle, torch.from_numpy(t), radius, *walk, carried)
    white = torch.linalg.solve_triangular(root, d.permute(0, 2, 1).reshape(6 * n, W), upper=False)
    gram = white.T @ white / (W - 1)
    share = torch.linalg.eigvalsh(gram).clamp_min(0.0)
    # What a linear regression on the video leaves of a parameter's variance.
    left = torch.linalg.inv(torch.eye(W, dtype=gram.dtype) + gram)
    remaining = {name: float(((t @ left @ t) / (t @ t)).sqrt()) for name, t in logarithms.items()}
    last = d[-1].std(0)
    return Candidate(
        motion=motion,
        information=0.5 * float(torch.log1p(share).sum()),
        position=float(last[3:5].norm()),
        yaw=float(last[2]),
        remaining=remaining,
        X_WO=Pose(found.q[-1], found.p[-1]),
        amplification=1.0 if own is not None else _amplification(scene, parameters, X_WO, motion, t, radius),
    )


def _amplification(
    scene: Scene, parameters: Parameters, X_WO: Pose, motion: StraightPush, t: np.ndarray, radius: float
) -> float:
    """By how much farther aside an object of a radius [m] ends than it starts, median over the first draws.

    The pusher's motion is moved in place of the object: across its direction, and about the object, to both sides.
    """
    number = min(_ASIDES, parameters.num_worlds)
    x, y = (float(value) for value in motion.direction_W[:2] / np.linalg.norm(motion.direction_W[:2]))
    place, turn = _ASIDE
    moves = torch.tensor([[-place * y, place * x, 0.0], [0.0, 0.0, turn]], dtype=torch.float64)
    moves = torch.cat([torch.zeros(1, 3, dtype=torch.float64), moves, -moves])
    frames, rows = moves.repeat_interleave(number, 0), torch.arange(number).repeat(len(moves))
    few = Parameters(*(tensor[rows] for tensor in parameters.tensors()))
    found = rollout_worlds(scene, few, X_WO, trajectory_of(motion), t[[0, -1]], (frames, X_WO.p))
    end = Pose(found.q[-1], found.p[-1])
    # An object that goes with the pusher ends as far aside as that.
    same = moved_pose(Pose(end.q[:number].repeat(len(moves), 1), end.p[:number].repeat(len(moves), 1)), frames, X_WO.p)
    d = deviation(end, same)
    far = torch.hypot(d[:, 3:5].norm(dim=1), radius * d[:, 2]).reshape(len(moves), number)
    start = torch.tensor([place, radius * turn, place, radius * turn], dtype=torch.float64)
    return float((far[1:] / start[:, None]).amax(0).median())
