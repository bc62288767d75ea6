"""Levenberg-Marquardt on the rendering loss: the last millimetre, and the curvature that intervals come from.

The images enter through their derivatives with respect to the pose in each frame, and the poses through their
derivatives with respect to the unknowns; both are central differences of the forward models, which average over the
kinks of contact and of pixels. Source: Nocedal and Wright, Numerical Optimization, section 10.3.
"""

from collections.abc import Callable
from dataclasses import dataclass

import torch
from torch import Tensor

from pinwm_drake.identification.adam import MEASUREMENTS
from pinwm_drake.identification.image_loss import difference
from pinwm_drake.identification.pictures import Pictures
from pinwm_drake.identification.problem import Problem
from pinwm_drake.spatial.poses import Pose, inverse
from pinwm_drake.spatial.rotations import quaternion_conjugate, quaternion_exp, quaternion_log, quaternion_multiply

# Steps of the differences: of an unknown, in z; in the image, px; of the outline's logarithm. That of the unknowns is 2
# to 4 %: pushes that begin or end within another time step make poses a sawtooth of theta below 1 %.
_STEP_Z, _STEP_PIXELS, _STEP_OUTLINE = 0.12, 0.25, 2e-3
_FIRST_DAMPING, _LEAST_DAMPING, _MOST_DAMPING = 1e-2, 1e-6, 1e6
# A relative gain of the objective below this ends the search, unless the step was held back by the damping.
_LEAST_GAIN, _FREE_STEP = 1e-4, 0.1


@dataclass(frozen=True, eq=False)
class Quadratic:
    """The objective around a point, J(z + d) = J + g d + d A d / 2, frame by frame.

    Attributes:
        loss: (n,), mean squares of the frames.
        gradient: (n, p), of half of them.
        curvature: (n, p, p), of half of them (Gauss-Newton).
        poses: X_WO at the point: q (n, 4), p (n, 3).
    """

    loss: Tensor
    gradient: Tensor
    curvature: Tensor
    poses: Pose


@dataclass
class NewtonState:
    """State of the search: everything that going on needs.

    Attributes:
        iteration: Number of steps tried.
        z: (p,), the guess of the unknowns.
        damping: Damping of the next step.
        weight: Factor of a frame's mean squares, against the prior.
        loss: Mean squares, mean over frames.
        done: Whether the search has ended.
    """

    iteration: int
    z: Tensor
    damping: float
    weight: float
    loss: float
    done: bool


@torch.no_grad()
def expand(problem: Problem, pictures: Pictures, z: Tensor) -> Quadratic | None:
    """Quadratic model of the frames' losses at z (p,); None where the physics has no solution."""
    p, n = len(z), len(pictures.color)
    steps = _STEP_Z * torch.eye(p, dtype=torch.float64)
    trial = torch.cat([z[None], z + steps, z - steps])
    X_WO, alive = problem.forward.poses(problem.coordinates.values(problem.coordinates.clamp(trial)))
    if not bool(alive[0]):
        return None
    at = Pose(X_WO.q[:, 0], X_WO.p[:, 0])
    values = problem.coordinates.values(z)
    outline = values["outline"][None]
    step_p, step_r = _image_steps(problem, pictures, at)

    def residual(X_WO: Pose, outline: Tensor) -> Tensor:
        X_WO = Pose(X_WO.q[:, None], X_WO.p[:, None])
        return difference(pictures, problem.surfels, X_WO, outline, num_threads=problem.num_threads).reshape(n, -1)

    r = residual(at, outline)
    M = r.shape[1]
    columns = []
    for axis in range(7):
        sides = []
        for sign in (1.0, -1.0):
            turn, shift = torch.zeros(n, 3, dtype=torch.float64), torch.zeros(n, 3, dtype=torch.float64)
            scale = outline
            if axis < 3:
                turn[:, axis] = sign * step_r
            elif axis < 6:
                shift[:, axis - 3] = sign * step_p
            else:
                scale = outline * (1.0 + sign * _STEP_OUTLINE)
            sides.append(residual(Pose(quaternion_multiply(quaternion_exp(turn), at.q), at.p + shift), scale))
        step = (step_r, step_p, _STEP_OUTLINE)[axis // 3]
        columns.append((sides[0] - sides[1]) / (2.0 * step))
    J = torch.stack(columns, -1)
    H = (J.mT @ J).double() / M
    g = (J.mT @ r[..., None]).double()[..., 0] / M
    D = _pose_derivatives(problem, X_WO, alive, trial, z)
    return Quadratic(
        loss=(r * r).mean(-1).double(),
        gradient=torch.einsum("nap,na->np", D, g),
        curvature=torch.einsum("nap,nab,nbq->npq", D, H, D),
        poses=at,
    )


def _image_steps(problem: Problem, pictures: Pictures, X_WO: Pose) -> tuple[float, float]:
    """Steps of position [m] and rotation [rad] that move the image by about `_STEP_PIXELS`."""
    away = (X_WO.p[0] - inverse(pictures.X_CW).p).norm()
    step = _STEP_PIXELS * float(away) / float(pictures.camera.intrinsics[0, 0])
    radius = 0.5 * float((problem.forward.scene.mesh.extents**2).sum() ** 0.5)
    return step, step / radius


def _pose_derivatives(problem: Problem, X_WO: Pose, alive: Tensor, trial: Tensor, z: Tensor) -> Tensor:
    """Derivatives (n, 7, p) of rotation vector, position and log outline by z."""
    p, n = len(z), len(X_WO.p)
    D = torch.zeros(n, 7, p, dtype=torch.float64)
    used = problem.coordinates.clamp(trial)
    for column, name in enumerate(problem.coordinates.names):
        plus, minus = 1 + column, 1 + p + column
        # One-sided where a side has no solution; 0, as unobservable, where neither has.
        plus, minus = (plus if alive[plus] else 0), (minus if alive[minus] else 0)
        span = float(used[plus, column] - used[minus, column])
        if name == "outline":
            D[:, 6, column] = problem.coordinates.free[column].scale
        elif span > 0.0:
            turn = quaternion_log(quaternion_multiply(X_WO.q[:, plus], quaternion_conjugate(X_WO.q[:, minus])))
            D[:, :3, column] = turn / span
            D[:, 3:6, column] = (X_WO.p[:, plus] - X_WO.p[:, minus]) / span
    return D


def weight_for(loss: float) -> float:
    """Factor of a frame's mean squares for which `loss` counts as noise."""
    return MEASUREMENTS / loss


def polish(
    problem: Problem,
    pictures: Pictures,
    state: NewtonState,
    *,
    iterations: int,
    report: Callable[[NewtonState], None],
) -> NewtonState:
    """Goes on from a state until nothing is gained, or to the last iteration.

    Args:
        problem: The episode to explain.
        pictures: The pictures to explain.
        state: State to begin with; changed in place.
        iterations: Steps in all.
        report: Called after each step.

    Returns:
        The state at the end.
    """
    P = problem.coordinates.precision
    model = None
    while not state.done and state.iteration < iterations:
        if model is None:
            model = expand(problem, pictures, state.z)
            if model is None:
                state.done = True
                break
            state.loss = float(model.loss.mean())
        A = state.weight * model.curvature.sum(0) + P
        b = -(state.weight * model.gradient.sum(0) + P @ state.z)
        step = torch.linalg.solve(A + state.damping * torch.diag(A.diagonal()), b)
        trial = problem.coordinates.clamp(state.z + step)
        before = objective(problem, state.weight, model.loss, state.z)
        losses = problem.frame_losses(pictures, trial[None], (1,))[:, 0]
        after = objective(problem, state.weight, losses, trial)
        state.iteration += 1
        if after < before:
            gain = (before - after) / before
            state.z, state.loss, model = trial, float(losses.mean()), None
            state.done = gain < _LEAST_GAIN and state.damping < _FREE_STEP
            state.damping = max(state.damping * 0.2, _LEAST_DAMPING)
        else:
            state.damping *= 8.0
            state.done = state.damping > _MOST_DAMPING
        report(state)
    return state


def objective(problem: Problem, weight: float, losses: Tensor, z: Tensor) -> float:
    """Weighted half of the frames' losses (n,) plus the prior's penalty."""
    return float(0.5 * weight * losses.sum() + problem.coordinates.penalty(z))
