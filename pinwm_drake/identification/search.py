# SPDX-License-Identifier: MIT
"""The search for the unknowns: random guesses, Adam from the best, refinement, guesses anew, draws from the posterior.

Every phase ends with arrays that the next one begins with, and every few steps Adam leaves its state in the checkpoint
too; the refinement of a start at one size, the later guesses, which cost no rendering, and the draws take some ten
seconds each and begin anew. So an interrupted search goes on where it was, and comes to the same result.
"""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path

import numpy as np
import torch
from torch import Tensor

from pinwm_drake.capture.episodes import Episode
from pinwm_drake.errors import SolverError
from pinwm_drake.identification.adam import AdamState, descend
from pinwm_drake.identification.checkpoint import Checkpoint
from pinwm_drake.identification.forward import Forward
from pinwm_drake.identification.history import Log
from pinwm_drake.identification.image_loss import BLOCKS, rendered
from pinwm_drake.identification.lighting import lit
from pinwm_drake.identification.locate import LIMIT
from pinwm_drake.identification.objective import LEAST_GAIN
from pinwm_drake.identification.options import IdentifyOptions
from pinwm_drake.identification.pictures import Footage, Pictures, first_frames, make_pictures, spaced
from pinwm_drake.identification.posterior import Posterior
from pinwm_drake.identification.problem import FilmedEpisode, Problem
from pinwm_drake.identification.refine import RefineState, Surrogate, joint_loss, refine, surrogate_at, weights_of
from pinwm_drake.identification.sampling import sample
from pinwm_drake.identification.unknowns import Coordinates
from pinwm_drake.rendering.surfels import Surfels
from pinwm_drake.spatial.poses import Pose
from pinwm_drake.twin.drift import DRIFTS
from pinwm_drake.twin.frame import FRAME, moved_pose

# A start whose coarse loss is within this factor of the best one is refined, and at most so many of them.
_CLOSE, _REFINED = 1.5, 2
# Starts are refined on pictures of the first of these shares of the fine size, and the best of them on the next: the
# images are quadratic over a pixel or two only. The later pictures are made with the clock that was found, which tells
# where the pusher hides pixels.
_SIZES = (0.5, 1.0)
# Mean of draws above a bound, in their standard deviations, below which they are densest at it: that of half a normal
# distribution is 1.32, and that of an even one is 1.73.
_DENSEST = 1.5
# Guesses without a rendering, for each that is screened with one.
GUESSES = 8
_SKETCHES, _SKETCH_SIZE = 4, 80.0  # pictures that show a guess, and the longer side of the object in them, px
# Shares of the work that the stages take.
_SHARES = {"screen": (0.0, 0.0), "coarse": (0.0, 0.4), "fine": (0.4, 0.3), "sample": (0.7, 0.3)}


@dataclass(frozen=True)
class Progress:
    """Progress of a search, to be shown while it goes on."""

    done: float  # Share of the work, 0 to 1
    stage: str  # "screen", "coarse", "fine" or "sample"
    loss: float  # Mean square of the stage's pictures for the best guess; not a number while draws are taken
    values: Mapping[str, float]  # Physical values of the free unknowns of that guess
    # Function that gives some pictures of the first push and their renderings for that guess, each (height, width, 3)
    # in [0, 1], sRGB
    pairs: Callable[[], list[tuple[np.ndarray, np.ndarray]]] = list


@dataclass(frozen=True, eq=False)
class Outcome:
    """Unknowns that a search found, with its losses and its log."""

    coordinates: Coordinates
    posterior: Posterior  # Draws of the unknowns, and what stands for them
    loss: float  # Mean square of the largest pictures, at the corrected poses; of poses see `pose_fit.py`
    poses: list[Pose]  # X_WO by the model in the frames of each push: q (n, 4), p (n, 3) [m]
    coarse_losses: list[float]  # Losses of all starts after the coarse stage
    log: Log
    seconds: float  # Time taken, all runs together


@dataclass(frozen=True, eq=False)
class Found(Outcome):
    """Outcome of a search in images."""

    problem: Problem  # The pushes, on the largest pictures
    # The likeliest corrections of the poses in the frames of `problem`, of each push: (m, 6), rotation vectors
    # [rad] and positions [m]
    corrections: list[Tensor]
    start: int  # Number of the start that led to the result


@dataclass(frozen=True, eq=False)
class Task:
    """All that a search is given."""

    footages: Sequence[Footage]  # Frames of each push, those of `frame_numbers` at least
    forwards: Sequence[Forward]  # Physics of each push
    surfels: Surfels  # The object's appearance, frame O
    coordinates: Coordinates
    # x, y [m] and yaw [rad] (3,) of each push's start in its first pictures, as `find_start` found them
    starts: Sequence[Tensor]
    num_threads: int  # of the renderer

    def problem(self, size: float, most: int, z: Tensor | None) -> Problem:
        """Return the problem with at most so many frames of each push.

        Args:
            size: Longer side of the object in the pictures, px.
            most: Frames of each push, evenly spaced.
            z: (p,), whose clocks tell where the pusher hides the object, for pictures with boxes of their own; None for
                pictures that share a box, with clocks as they were written.
        """
        pushes = []
        for number, (footage, forward) in enumerate(zip(self.footages, self.forwards, strict=True)):
            chosen = spaced(len(footage.episode.times), most)
            forward = replace(forward, chosen=chosen)
            values = None if z is None else self.coordinates.values(z[None], number)
            late, frame = 0.0, torch.zeros(3, dtype=torch.float64)
            if values is not None:
                late, frame = float(values["time_offset"]), torch.cat([values[name] for name in FRAME]).detach()
            placed = partial(moved_pose, frame=frame, pivot=forward.X_WO.p if forward.pivot is None else forward.pivot)
            pictures = make_pictures(footage.some(chosen), size, together=z is None, late=late, placed=placed)
            surfels = self._lit(pictures, forward, values)
            pushes.append(FilmedEpisode(forward, pictures, surfels))
        return Problem(tuple(pushes), self.coordinates, self.num_threads)

    def started(self, z: Tensor) -> Tensor:
        """Guesses z (W, p) that show each push's start where its first pictures have it, where that is free."""
        z = z.clone()
        for number, d in enumerate(self.starts):
            if bool((d.abs() > LIMIT).any()):
                continue
            columns = {self.coordinates.free[column].name: column for column in self.coordinates.columns(number)}
            wanted = {"start_yaw": float(d[2])}
            for axis, total in zip("xy", d.tolist(), strict=False):
                # What is seen aside of the static views was moved, or the camera is wrong: each as likely as its prior.
                names = [name for name in (f"start_{axis}", f"view_{axis}") if name in columns]
                variances = [self.coordinates.deviations[columns[name]] ** 2 for name in names]
                wanted |= {name: total * one / sum(variances) for name, one in zip(names, variances, strict=True)}
            for name, value in wanted.items():
                if name in columns:
                    z[:, columns[name]] = value / self.coordinates.free[columns[name]].scale
        return self.coordinates.clamp(z)

    def _lit(self, pictures: Pictures, forward: Forward, values: dict[str, Tensor] | None) -> Surfels:
        """Surfels in the light of pictures, by the first of them where no motion is known."""
        if values is None:
            first = pictures.some(torch.zeros(1, dtype=torch.long))
            start = Pose(forward.X_WO.q[None], forward.X_WO.p[None])
            return lit(first, self.surfels, start, num_threads=self.num_threads)
        with torch.no_grad():
            X_WO, alive = forward.shown(values)
        if not bool(alive[0]):
            return self.surfels
        return lit(pictures, self.surfels, Pose(X_WO.q[:, 0], X_WO.p[:, 0]), num_threads=self.num_threads)


def frame_numbers(episode: Episode, options: IdentifyOptions) -> Tensor:
    """Numbers of the frames that a search looks at, increasing."""
    chosen = [spaced(len(episode.times), most) for most in (options.coarse_frames, options.fine_frames)]
    return torch.cat([first_frames(episode), *chosen]).unique()


class Search:
    """Search for the unknowns of one push or several; see the module's text."""

    def __init__(
        self,
        task: Task,
        options: IdentifyOptions,
        *,
        folder: Path | None,
        about: Mapping[str, object],
        resume: bool,
        report: Callable[[Progress], None],
    ) -> None:
        """Read the checkpoint, to go on, as `Checkpoint` does; `report` is called after each step."""
        self.task, self.options, self.report = task, options, report
        self.coordinates = task.coordinates
        self.kept = Checkpoint(
            folder, about, resume=resume, every=options.checkpoint_every, size=len(self.coordinates.names)
        )
        self._sketched: Problem | None = None

    def run(self) -> Found:
        """Search, or go on with an interrupted search.

        Raises:
            SolverError: The physics found no solution for any guess.
        """
        self._coarse()
        coarse = self.kept.result("coarse")
        starts, losses = coarse["z"], coarse["loss"]
        if not bool(torch.isfinite(losses).any()):
            raise SolverError("the physics found no solution for any start; try another seed or a smaller time step")
        order = torch.argsort(losses, stable=True)
        chosen = [int(k) for k in order[:_REFINED] if float(losses[k]) <= _CLOSE * float(losses.min())]
        # Several starts on pictures of the first size, the best of them on the others.
        found = [self._fine(0, k, starts[k], None, (place, len(chosen))) for place, k in enumerate(chosen)]
        surrogate, state, start = _best([(*one, k) for one, k in zip(found, chosen, strict=True)])
        state = self._widened(surrogate, state)
        for turn in range(1, len(_SIZES)):
            surrogate, state, start = _best([(*self._fine(turn, start, state.z, state, (0, 1)), start)])
        draws, energies = self._sample(surrogate, state.z)
        return self._found(surrogate, state, start, draws, energies)

    def _coarse(self) -> None:
        """Screens random guesses and descends from the best, on small pictures."""
        options = self.options
        if self.kept.result("coarse"):
            return
        problem = self.task.problem(options.coarse_size, options.coarse_frames, None)
        state = self.kept.load_adam("coarse")
        if state is None:
            guesses = self.coordinates.draw(options.screened, torch.Generator().manual_seed(options.seed))
            guesses = self.task.started(guesses)
            guesses = problem.fit_outline(guesses)
            with torch.no_grad():
                losses = torch.cat(problem.frame_losses(guesses, BLOCKS)).mean(0)
            order = torch.argsort(losses, stable=True)[: options.starts]
            self._show("screen", float(losses[order[0]]), guesses[order[0]], 0.0)
            state = AdamState.at(guesses[order])

        def report(state: AdamState, losses: Tensor) -> None:
            for start, loss in enumerate(losses.tolist()):
                self._note("coarse", start, loss, state.z[start])
            best = int(state.best_loss.argmin())
            share = state.iteration / max(options.coarse_iterations, 1)
            self._show("coarse", float(state.best_loss[best]), state.best_z[best], share)
            self.kept.save_adam("coarse", state)

        descend(problem, state, iterations=options.coarse_iterations, report=report)
        losses = state.best_loss if options.coarse_iterations else torch.zeros(len(state.z), dtype=torch.float64)
        self.kept.end("coarse", {"z": state.best_z, "loss": losses})

    def _fine(
        self, turn: int, start: int, z: Tensor, before: RefineState | None, place: tuple[int, int]
    ) -> tuple[Surrogate | None, RefineState]:
        """Refines a start z (p,), or the state before, to which another size led it, on pictures of one of `_SIZES`.

        The progress needs its place: its number among the starts that are refined, and how many they are.
        """
        options, key = self.options, f"fine{turn}.{start}"
        problem = self.task.problem(_SIZES[turn] * options.fine_size, options.fine_frames, z)
        if done := self.kept.result(key):
            state = RefineState(0, done["z"], done["corrections"], float(done["loss"]), True)
            return surrogate_at(problem, state.z, state.corrections), state
        state = RefineState.at(problem, z) if before is None else replace(before, iteration=0, done=False)
        state.z = problem.fit_outline(state.z[None])[0]

        def report(state: RefineState) -> None:
            self._note("fine", start, state.loss, state.z)
            done = (place[0] + state.iteration / max(options.fine_iterations, 1)) / place[1]
            self._show("fine", state.loss, state.z, (turn + done) / len(_SIZES))

        state, surrogate = refine(problem, state, iterations=options.fine_iterations, report=report)
        self.kept.end(key, {"z": state.z, "corrections": state.corrections, "loss": state.loss})
        return surrogate, state

    def _widened(self, surrogate: Surrogate, state: RefineState) -> RefineState:
        """State at the best minimum that random guesses of what is the object's lead to, where that explains more.

        By now the images' surrogate shows the way of the object, and a guess costs no rendering.
        """
        coordinates, options = self.coordinates, self.options
        number, generator = GUESSES * options.screened, torch.Generator().manual_seed(options.seed)
        physical = torch.tensor([unknown.physical for unknown in coordinates.free])
        guesses = torch.where(physical, coordinates.draw(number, generator), state.z)
        ends = [surrogate.minimise(guess) for guess in surrogate.ranked(guesses)[: options.starts]]
        found = torch.stack([state.z, *ends])
        values = surrogate.objective(found)
        least = int(values.argmin())
        if float(values[least]) > float(values[0]) - LEAST_GAIN:
            return state
        z = found[least]
        return replace(state, z=z, corrections=torch.cat(surrogate.corrections(z, surrogate.walk(z))))

    def _sample(self, surrogate: Surrogate, z: Tensor) -> tuple[Tensor, Tensor]:
        """Draws (N, p) from the posterior, and their objectives (N,)."""
        if not self.kept.result("sample"):
            A, _ = surrogate.quadratic(z)
            draws, energies = sample(
                surrogate.objective,
                z[None],
                torch.linalg.inv(A)[None],
                self.coordinates.clamp,
                torch.Generator().manual_seed(self.options.seed),
                moves=self.options.moves,
                report=lambda share: self._show("sample", float("nan"), z, share),
            )
            self.kept.end("sample", {"z": draws, "objective": energies})
        found = self.kept.result("sample")
        return found["z"], found["objective"]

    def _found(self, surrogate: Surrogate, state: RefineState, start: int, draws: Tensor, energies: Tensor) -> Found:
        z = representative(surrogate.objective, self.coordinates, draws, energies)
        poses = []
        for number, forward in enumerate(self.task.forwards):
            X_WO, alive = forward.poses(self.coordinates.values(z[None], number))
            if not bool(alive[0]):
                raise SolverError(
                    "the physics found no solution at the optimum; try another seed or a smaller time step"
                )
            poses.append(X_WO)
        return Found(
            coordinates=self.coordinates,
            problem=surrogate.problem,
            posterior=Posterior.of(
                z, draws, surrogate.fine_shares(z), torch.Generator().manual_seed(self.options.seed)
            ),
            loss=state.loss,
            poses=[Pose(X.q[:, 0], X.p[:, 0]) for X in poses],
            corrections=surrogate.corrections(z, surrogate.walk(z)),
            coarse_losses=self.kept.result("coarse")["loss"].tolist(),
            start=start,
            log=self.kept.log,
            seconds=self.kept.seconds,
        )

    def _note(self, stage: str, start: int, loss: float, z: Tensor) -> None:
        self.kept.log.add(stage, start, loss, list(self.coordinates.named(z).values()))

    def _show(self, stage: str, loss: float, z: Tensor, share: float) -> None:
        first, width = _SHARES[stage]
        done, values = min(first + width * share, 1.0), self.coordinates.named(z)
        self.report(Progress(done, stage, loss, values, lambda: self._sketch(z)))

    @torch.no_grad()
    def _sketch(self, z: Tensor) -> list[tuple[np.ndarray, np.ndarray]]:
        """Pictures and renderings for a guess z (p,); see `Progress`."""
        if self._sketched is None:
            self._sketched = self.task.problem(_SKETCH_SIZE, _SKETCHES, None)
        push, values = self._sketched.pushes[0], self.coordinates.values(z[None], 0)
        X_WO, alive = push.forward.shown(values)
        if not bool(alive[0]):
            return []
        shown = rendered(push.pictures, push.surfels, X_WO, values["outline"], num_threads=self.task.num_threads)
        pictures = zip(push.pictures.color, shown.color[:, 0].clamp(0, 1), strict=True)
        return [(target.numpy(), rendering.numpy()) for target, rendering in pictures]


def _best(candidates: list[tuple[Surrogate | None, RefineState, int]]) -> tuple[Surrogate, RefineState, int]:
    """Return the candidate that explains images best, with equal weights; raise SolverError without one."""
    alive = [(surrogate, state, start) for surrogate, state, start in candidates if surrogate is not None]
    if not alive:
        raise SolverError("the physics found no solution at the optimum; try another seed or a smaller time step")
    best = min(alive, key=lambda one: float(torch.cat([part.loss for part in one[0].expansions]).median()))[0]
    weights = weights_of(best.expansions)

    def loss(one: tuple[Surrogate, RefineState, int]) -> float:
        surrogate, state, _ = one
        # With the widest drift, which allows any of them.
        walk = len(DRIFTS) - 1
        return joint_loss(surrogate, state.z, state.corrections, weights, walk)

    return min(alive, key=loss)


def representative(
    objective: Callable[[Tensor], Tensor], coordinates: Coordinates, draws: Tensor, energies: Tensor
) -> Tensor:
    """Unknowns (p,) that stand for a posterior.

    They are its mean where that is as likely as its draws are. Where the posterior is bent, the mean is not; then it is
    the draw nearest to the mean, in units of the draws' covariance, of the likelier half. An unknown that cannot be
    less than what it usually is, such as a restitution of zero, is that wherever the draws are densest there: their
    mean never is. Others then have the mean that goes with it.

    Args:
        objective: Minus the logarithm of the density (W,) of unknowns (W, p).
        coordinates: The unknowns.
        draws: (N, p).
        energies: (N,), their objectives.
    """
    mean = draws.mean(0)
    usual = float(energies.median())
    least = coordinates.one_sided & (mean - coordinates.low < _DENSEST * draws.std(0))
    likely = draws[energies <= usual]
    covariance = torch.cov(draws.T) + 1e-9 * torch.eye(draws.shape[1], dtype=torch.float64)
    away = likely - mean
    nearest = likely[int((away * torch.linalg.solve(covariance, away.T).T).sum(-1).argmin())]
    # What goes with them: the others' mean, given that these are least.
    among = covariance[least][:, least]
    given = mean + covariance[:, least] @ torch.linalg.solve(among, (coordinates.low - mean)[least])
    for z in (torch.where(least, coordinates.low, given), mean, torch.where(least, coordinates.low, nearest)):
        if float(objective(z[None])[0]) <= usual:
            return z
    return nearest
