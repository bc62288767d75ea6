# SPDX-License-Identifier: MIT
"""Identification of a twin from measured poses in the place of images: the same unknowns, intervals and next push.

Random guesses are screened, and the best of them refined one by one, on the objective of `surrogate.py`; the noise of
the measurement is told by what neighbouring poses do not share, first of the measured poses, then of their residuals.
"""

import hashlib
import math
import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np
import torch
from torch import Tensor

from pinwm_drake.capture.episodes import Episode, ObjectPoses
from pinwm_drake.capture.measured_poses import MeasuredPoses, within_log
from pinwm_drake.capture.scene import Capture
from pinwm_drake.errors import SolverError
from pinwm_drake.geometry.meshes import half_diagonal
from pinwm_drake.identification.forward import Forward
from pinwm_drake.identification.history import Log
from pinwm_drake.identification.identify import (
    Identification,
    capture_scene,
    chosen_unknowns,
    distinct_pushes,
    found_twin,
    given_mass,
    object_priors,
)
from pinwm_drake.identification.mass import find_mass_scale, with_mass
from pinwm_drake.identification.options import IdentifyOptions
from pinwm_drake.identification.pictures import spaced
from pinwm_drake.identification.poses.noise import checked, track, white_noise
from pinwm_drake.identification.poses.surrogate import PosedEpisode, PosedProblem, PoseSurrogate, pose_surrogate
from pinwm_drake.identification.posterior import KEPT, PRIOR_NOTE, Posterior
from pinwm_drake.identification.sampling import sample
from pinwm_drake.identification.search import GUESSES, Outcome, Progress, representative
from pinwm_drake.identification.time_step import time_step_of
from pinwm_drake.identification.unknowns import BODIES, UNKNOWNS, Coordinates
from pinwm_drake.reading.contents import read_bytes
from pinwm_drake.rendering.surfels import Surfels
from pinwm_drake.spatial.poses import Pose
from pinwm_drake.spatial.rotations import turn_between
from pinwm_drake.threads import one_torch_thread
from pinwm_drake.twin.origin import Origin, registration_entry
from pinwm_drake.twin.predict import TWO_SIDED
from pinwm_drake.twin.twin import Estimate

# Unknowns of one push that poses depend on; a camera's are none of them.
_OWN = ("start_x", "start_y", "start_yaw", "time_offset", "grip_floor", "grip_pusher")
_ROUNDS = 3
# Shares of the way to a surrogate's minimum that are tried.
_STEPS = (1.0, 0.5, 0.25, 0.125)
# Minima count as modes of the posterior up to so much less likely (logarithm), and so far apart in one unknown.
_UNLIKELY, _SAME_MODE = 8.0, 0.05
# Objectives of minima that are the same.
_SAME_VALUE = 0.5


@dataclass(frozen=True, eq=False)
class _End:
    """Minimum that a search found: shared unknowns (p,), those (m,) of each push, its surrogate and joint objective."""

    z: Tensor
    at: list[Tensor]
    surrogate: PoseSurrogate
    value: float

    def same(self, other: "_End") -> bool:
        """Whether another search ended in the same minimum."""
        return abs(self.value - other.value) < _SAME_VALUE and float((self.z - other.z).abs().max()) < _SAME_MODE


@dataclass(frozen=True, eq=False)
class PoseNotes:
    """What an identification says of measured poses.

    Attributes:
        sigma: (6,), white noise of rotation [rad] and position [m], world axes.
        wrong: Rows of each table that were left out, as lines of the file, by the names of push and file.
        left_out: Rows before or after the pushers' logs.
        hashes: SHA-256 of each table, by the name of its push.
    """

    sigma: Tensor
    wrong: dict[str, list[int]]
    left_out: int
    hashes: dict[str, str]

    def entry(self) -> dict[str, object]:
        """Return plain data for the provenance of a twin."""
        noise = {"position": self.sigma[3:].tolist(), "rotation": self.sigma[:3].tolist()}
        return {
            "noise": noise,
            "wrong_lines": self.wrong,
            "rows_outside_log": self.left_out,
            "sha256": self.hashes,
            "units": "m, rad",
        }


def identify_poses(
    capture: Capture,
    episodes: Episode | Sequence[Episode],
    measured: Sequence[MeasuredPoses],
    surfels: Surfels,
    camera_offset: tuple[float, float] = (0.0, 0.0),
    options: IdentifyOptions | None = None,
    *,
    report: Callable[[Progress], None] = lambda _: None,
) -> Identification:
    """Find theta such that the physics reproduces measured poses of one push or several.

    Each push starts where its first rows have the object. Arguments, result and errors are those of `identify_theta`.

    Args:
        capture: Object, pusher, floor, gravity.
        episodes: The push, or the pushes.
        measured: Poses of each.
        surfels: An appearance for the twin, frame O.
        camera_offset: px, of the capture's cameras.
        options: Options of the search. Of those of pictures only `fine_frames` counts: the rows of a push that are
            fitted.
        report: Called after each step.
    """
    begun, options = time.monotonic(), options or IdentifyOptions()
    pushes, X_WO = distinct_pushes(episodes), capture.object.X_WO
    tables = [within_log(table, push.trajectory) for table, push in zip(measured, pushes, strict=True)]
    mass = given_mass(capture, options)
    with one_torch_thread():
        scene = capture_scene(capture, options.time_step or time_step_of(pushes), facets=options.facets)
        radius = half_diagonal(scene.mesh)
        sigma = white_noise([(one.poses.t, track(one.poses)) for one in tables], radius)
        sound = [checked(one, sigma, radius) for one in tables]
        whole = []
        for push, (table, _) in zip(pushes, sound, strict=True):
            posed = replace(push, t=table.poses.t, file_names=[], others=())
            forward = Forward(scene, posed, _pose(table.poses, 0), mass, options.threads, pivot=X_WO.p)
            whole.append(_posed(forward, table, None))
        chosen = [
            _posed(one.forward, table, spaced(one.num_frames, options.fine_frames))
            for one, (table, _) in zip(whole, sound, strict=True)
        ]
        free, held = chosen_unknowns(capture, options, scene, mass)
        # One push alone tells the product of an object's friction and its own factor.
        grips = {f"grip_{body}": f"friction_{body}" for body in BODIES} if len(pushes) == 1 else {}
        grips = {grip: friction for grip, friction in grips.items() if grip in free and friction in free}
        own_names = [name for name in _OWN if name in free and name not in grips]
        far = {f"start_{axis}": 3.0 * float(sigma[3:5].max()) for axis in "xy"} | {"start_yaw": 3.0 * float(sigma[2])}
        priors = {name: max(UNKNOWNS[name].prior, one) for name, one in far.items()}
        own = Coordinates(own_names, held, 1, [priors]) if own_names else None
        shared = [name for name in free if UNKNOWNS[name].shared]
        coordinates = Coordinates(shared, held, 1, shared=object_priors(capture, scene))
        problem = PosedProblem(tuple(chosen), coordinates, own)
        search = _Search(problem, tuple(whole), options, radius, report)
        surrogate, z, sigma = search.run(sigma)
        found, owns = search.outcome(surrogate, z, begun)
        unknown = capture.object.mass is None and "mass" not in (*options.held, *options.names)
        forwards = [one.forward for one in whole]
        drawn = torch.cat([found.posterior.z[None], found.posterior.kept])
        values = [search.values(drawn, mean.expand(len(drawn), -1)) for mean, _ in owns]
        scale = find_mass_scale(forwards, values, options.seed) if unknown else None
        found = replace(found, posterior=_parted(coordinates, found.posterior, grips, options.seed))
    wrong = {
        f"{push.name}/{table.path.name}": lines for push, (table, lines) in zip(pushes, sound, strict=True) if lines
    }
    hashes = {
        push.name: hashlib.sha256(read_bytes(table.path)).hexdigest()
        for push, table in zip(pushes, tables, strict=True)
    }
    notes = PoseNotes(sigma, wrong, sum(table.left_out for table in tables), hashes)
    about = {**Origin.of(capture, pushes).to_provenance(), **registration_entry(X_WO, X_WO), "poses": notes.entry()}
    first = pushes[0].start or X_WO
    twin = found_twin(capture, scene, found, options, surfels, camera_offset, mass, X_WO, about, q_WO=first.q)
    starts = [X_WO if push.start is None else push.start for push in pushes]
    for number, (one, start, (mean, cov)) in enumerate(zip(whole, starts, owns, strict=True)):
        if own is not None:
            suffix = f".{number}" if len(pushes) > 1 else ""
            estimates = _own_estimates(own, mean, cov, one.forward.X_WO, start)
            twin.nuisance.update({name + suffix: value for name, value in estimates.items()})
            if suffix:
                for name in estimates:
                    twin.nuisance.pop(name, None)
    for grip in grips:
        spread = math.exp(TWO_SIDED * UNKNOWNS[grip].prior)
        twin.nuisance[grip] = Estimate(1.0, (1.0 / spread, spread), False, UNKNOWNS[grip].unit, PRIOR_NOTE)
    twin = with_mass(twin, scale)
    poses = [
        ObjectPoses(one.forward.times, X.p.numpy(), X.q.numpy()) for one, X in zip(whole, found.poses, strict=True)
    ]
    return Identification(twin, found, poses)


class _Search:
    """Search for the shared unknowns; `whole` holds the pushes with all of their poses."""

    def __init__(
        self,
        problem: PosedProblem,
        whole: tuple[PosedEpisode, ...],
        options: IdentifyOptions,
        radius: float,
        report: Callable[[Progress], None],
    ) -> None:
        self.problem, self.whole, self.options, self.radius = problem, whole, options, radius
        self.report, self.log = report, Log()
        self.coarse_losses: list[float] = []
        self.ends: list[Tensor] = []  # (p,), minima that the search found from its starts
        self.start = 0  # Number of the start that led to the best of them

    def run(self, sigma: Tensor) -> tuple[PoseSurrogate, Tensor, Tensor]:
        """Return the surrogate at the best minimum that was found, its shared unknowns (p,), and the noise (6,).

        Random guesses are screened. The best are followed one by one, until two end in the best minimum so far.
        """
        options, coordinates = self.options, self.problem.coordinates
        m = 0 if self.problem.own is None else len(self.problem.own)
        at = [torch.zeros(m, dtype=torch.float64) for _ in self.whole]
        nominal = self._expand(torch.zeros(len(coordinates), dtype=torch.float64), at, sigma)
        guesses = coordinates.draw(GUESSES * options.screened, torch.Generator().manual_seed(options.seed))
        best: _End | None = None
        for number, guess in enumerate(nominal.ranked(guesses)[: options.starts]):
            try:
                z, owns, noise = self._followed(nominal, guess, at, sigma)
                noise = torch.minimum(sigma, noise)
                if best is not None and bool((noise < sigma).any()):
                    best = self._end(best.z, best.at, noise)
                end, sigma = self._end(z, owns, noise), noise
            except SolverError:
                self.coarse_losses.append(math.inf)
                continue
            self.ends.append(end.z)
            self.coarse_losses.append(end.surrogate.loss)
            self._note(end.surrogate, "fine", number, end.z, (number + 1) / options.starts)
            again = best is not None and end.same(best)
            if best is None or end.value < best.value:
                best, self.start = end, number
            if again:
                break
        if best is None:
            raise SolverError("the physics found no solution for any start; try another seed or a smaller time step")
        return best.surrogate, best.z, sigma

    def _followed(
        self, surrogate: PoseSurrogate, guess: Tensor, at: list[Tensor], sigma: Tensor
    ) -> tuple[Tensor, list[Tensor], Tensor]:
        """Shared unknowns (p,), those of each push, and noise (6,) to which a guess (p,) leads from a surrogate on."""
        z = surrogate.minimise(guess)
        surrogate = self._expand(z, at, sigma)
        for _ in range(_ROUNDS):
            z, at = self._step(surrogate, z, at)
            sigma = torch.minimum(sigma, self._residual_noise(z, at))
            surrogate = self._expand(z, at, sigma)
        return *self._step(surrogate, z, at), sigma

    def _end(self, z: Tensor, at: list[Tensor], sigma: Tensor) -> _End:
        surrogate = self._expand(z, at, sigma)
        return _End(z, at, surrogate, surrogate.joint(z, at, surrogate.walk(z)))

    def _step(self, surrogate: PoseSurrogate, z: Tensor, at: list[Tensor]) -> tuple[Tensor, list[Tensor]]:
        """Unknowns of the object (p,) and of each push on the way to a surrogate's minimum, as far as it explains more.

        The surrogate takes what unknowns of a push do for linear. Far away that is wrong.
        """
        goal = surrogate.minimise(z)
        walk = surrogate.walk(goal)
        wanted = at
        if self.problem.own is not None:
            wanted = [self.problem.own.clamp(surrogate.own(goal, push, walk)[0]) for push in range(len(at))]
        before = surrogate.joint(z, at, walk)
        for share in _STEPS:
            there = self.problem.coordinates.clamp(z + share * (goal - z))
            owns = [one + share * (other - one) for one, other in zip(at, wanted, strict=True)]
            if surrogate.joint(there, owns, walk) < before:
                return there, owns
        return z, at

    def outcome(self, surrogate: PoseSurrogate, z: Tensor, begun: float) -> tuple[Outcome, list[tuple[Tensor, Tensor]]]:
        """Outcome with draws, and mean (m,) and covariance (m, m) of the unknowns of each push."""
        coordinates, generator = self.problem.coordinates, torch.Generator().manual_seed(self.options.seed)
        means = torch.stack(_modes(surrogate, z, [*self.ends, *self._sticking(z)]))
        covariances = torch.stack([torch.linalg.inv(surrogate.quadratic(one)[0]) for one in means])
        draws, energies = sample(
            surrogate.objective, means, covariances, coordinates.clamp, generator, moves=self.options.moves
        )
        z = representative(surrogate.objective, coordinates, draws, energies)
        posterior = Posterior.of(z, draws, surrogate.fine_shares(z), torch.Generator().manual_seed(self.options.seed))
        walk = surrogate.walk(z)
        owns = [
            (torch.zeros(0, dtype=torch.float64),) * 2 if self.problem.own is None else surrogate.own(z, push, walk)
            for push in range(len(self.whole))
        ]
        poses = []
        for one, (mean, _) in zip(self.whole, owns, strict=True):
            X_WO, alive = one.forward.poses(self.values(z[None], mean[None]))
            if not bool(alive[0]):
                raise SolverError("the physics found no solution at the optimum; try a smaller time step")
            poses.append(Pose(X_WO.q[:, 0], X_WO.p[:, 0]))
        self._note(surrogate, "sample", self.start, z, 1.0)
        seconds = time.monotonic() - begun
        found = Outcome(coordinates, posterior, surrogate.loss, poses, self.coarse_losses, self.log, seconds)
        return found, owns

    def _sticking(self, z: Tensor) -> list[Tensor]:
        """Unknowns z (p,) with so much friction of the pusher that it sticks: how much there is makes no difference.

        Searches seldom end there, as nothing but the prior leads them on.
        """
        coordinates = self.problem.coordinates
        if "friction_pusher" not in coordinates.names:
            return []
        column, most = coordinates.names.index("friction_pusher"), UNKNOWNS["friction_pusher"]
        other = z.clone()
        other[column] += most.prior / most.scale
        return [coordinates.clamp(other)]

    def values(self, z: Tensor, own: Tensor) -> dict[str, Tensor]:
        """Values (W,) of `UNKNOWNS`, of shared unknowns (W, p) and those of a push (W, m)."""
        clamped = own if self.problem.own is None else self.problem.own.clamp(own)
        return self.problem.values(z, clamped)

    def _expand(self, z: Tensor, at: list[Tensor], sigma: Tensor) -> PoseSurrogate:
        found = pose_surrogate(self.problem, z, at, sigma)
        if found is None:
            raise SolverError("the physics found no solution at a guess; try another seed or a smaller time step")
        return found

    def _residual_noise(self, z: Tensor, at: list[Tensor]) -> Tensor:
        """Noise (6,) by the residuals of all poses."""
        residuals = []
        for one, own in zip(self.whole, at, strict=True):
            with torch.no_grad():
                d, _ = one.deviations(self.values(z[None], own[None]))
            residuals.append((one.forward.times, d[0].numpy()))
        return white_noise(residuals, self.radius)

    def _note(self, surrogate: PoseSurrogate, stage: str, start: int, z: Tensor, share: float) -> None:
        first, width = {"fine": (0.0, 0.8), "sample": (0.8, 0.2)}[stage]
        values = self.problem.coordinates.named(z)
        self.log.add(stage, start, surrogate.loss, list(values.values()))
        self.report(Progress(first + width * share, stage, surrogate.loss, values))


def _modes(surrogate: PoseSurrogate, z: Tensor, ends: Sequence[Tensor]) -> list[Tensor]:
    """Minima (p,) of a surrogate that are not much less likely than z (p,), z first; each of the ends leads to one."""
    found, most = [z], float(surrogate.objective(z[None])[0]) + _UNLIKELY
    for end in ends:
        one = surrogate.minimise(end)
        near = min(float((one - other).abs().max()) for other in found)
        if near > _SAME_MODE and float(surrogate.objective(one[None])[0]) < most:
            found.append(one)
    return found


def _posed(forward: Forward, table: MeasuredPoses, chosen: Tensor | None) -> PosedEpisode:
    rows = np.arange(len(table.poses.t)) if chosen is None else chosen.numpy()
    measured = Pose(torch.from_numpy(table.poses.q_WO[rows]), torch.from_numpy(table.poses.p_WO[rows]))
    seen = torch.tensor([not table.planar, not table.planar, True, True, True, not table.planar])
    return PosedEpisode(replace(forward, chosen=chosen), measured, seen)


def _pose(poses: ObjectPoses, row: int) -> Pose:
    return Pose(torch.from_numpy(poses.q_WO[row].copy()), torch.from_numpy(poses.p_WO[row].copy()))


def _parted(coordinates: Coordinates, posterior: Posterior, grips: dict[str, str], seed: int) -> Posterior:
    """Posterior of frictions that were found as products with factors of the push, by the priors of these."""
    generator, draws = torch.Generator().manual_seed(seed), posterior.draws.clone()
    for grip, friction in grips.items():
        noise = torch.randn(len(draws), generator=generator, dtype=torch.float64)
        column = coordinates.names.index(friction)
        draws[:, column] -= noise * UNKNOWNS[grip].prior / UNKNOWNS[friction].scale
    draws = coordinates.clamp(draws)
    return replace(posterior, draws=draws, kept=draws[spaced(len(draws), KEPT)])


def _own_estimates(
    own: Coordinates, mean: Tensor, covariance: Tensor, measured: Pose, start: Pose
) -> dict[str, Estimate]:
    """Estimates of the unknowns of a push by name; its start counts from where the capture has the object."""
    extra = dict(zip(("start_x", "start_y"), (measured.p - start.p)[:2].tolist(), strict=True))
    extra["start_yaw"] = float(turn_between(start.q, measured.q)[2])
    spread = covariance.diagonal().clamp_min(0.0).sqrt()
    ends = [own.named(own.clamp(mean + sign * TWO_SIDED * spread)) for sign in (0.0, -1.0, 1.0)]
    found = {}
    for unknown, one, before in zip(own.free, spread.tolist(), own.deviations, strict=True):
        value, low, high = (values[unknown.name] + extra.get(unknown.name, 0.0) for values in ends)
        told = one * unknown.scale < 0.5 * before
        found[unknown.name] = Estimate(value, (low, high), told, unknown.unit)
    return found
