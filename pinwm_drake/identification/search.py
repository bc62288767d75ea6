"""The search for the unknowns: random guesses, Adam from the best of them, Levenberg-Marquardt at the end.

Every phase ends with arrays that the next one begins with, and every few steps the phase at hand leaves its state in
the checkpoint too; so an interrupted search goes on where it was, and comes to the same result.
"""

from collections.abc import Callable, Mapping
from pathlib import Path

import numpy as np
import torch
from torch import Tensor

from pinwm_drake.errors import SolverError
from pinwm_drake.identification.adam import AdamState, descend
from pinwm_drake.identification.checkpoint import Checkpoint
from pinwm_drake.identification.gauss_newton import NewtonState, expand, polish, weight_for
from pinwm_drake.identification.image_loss import BLOCKS
from pinwm_drake.identification.options import IdentifyOptions
from pinwm_drake.identification.pictures import Footage, make_pictures
from pinwm_drake.identification.problem import Problem
from pinwm_drake.identification.progress import Progress
from pinwm_drake.identification.search_result import Found
from pinwm_drake.identification.uncertainty import laplace, profile
from pinwm_drake.scene import Support

_COARSE_RATE, _FINE_RATE = 0.5, 0.15
# Share of the coarse steps during which the frames that count grow.
_GROW = 0.6
# A support whose loss is within this factor of the best one goes on to the next stage.
_CLOSE = 1.6
# Polishing is done again, with the images weighted by what the first time revealed of their noise.
_ROUNDS = 2


class Search:
    """Search for the unknowns of one episode; see the module's text."""

    def __init__(
        self,
        problems: Mapping[Support, Problem],
        footage: Footage,
        options: IdentifyOptions,
        *,
        folder: Path | None = None,
        about: Mapping[str, object] | None = None,
        resume: bool = False,
        report: Callable[[Progress], None] = lambda _: None,
    ) -> None:
        """Prepares the pictures and, to go on, reads the checkpoint.

        Args:
            problems: Problems to solve, one for each support.
            footage: The frames.
            options: Options of the search.
            folder: Folder of the checkpoints; None for none.
            about: Inputs that the search depends on; a checkpoint of another search is refused.
            resume: Whether to go on from the checkpoint, if there is one.
            report: Called after each step.

        Raises:
            InputError: The checkpoint is of another search, or cannot be read.
        """
        self.problems, self.options, self.report = problems, options, report
        coarse = make_pictures(footage, options.coarse_size, together=True)
        n = len(footage.images)
        self.chosen = torch.linspace(0, n - 1, min(options.coarse_frames, n)).round().long()
        self.coarse = coarse.some(self.chosen)
        self.fine = make_pictures(footage, options.fine_size, together=False)
        self.kept = Checkpoint(folder, about or {}, resume=resume, every=options.checkpoint_every)

    def run(self) -> Found:
        """Searches, or goes on with an interrupted search.

        Raises:
            SolverError: The physics found no solution for any guess.
        """
        for number, support in enumerate(self.problems):
            self._coarse(number, support)
        coarse = {support: float(self.kept.done[f"coarse.{support}.loss"]) for support in self.problems}
        hopeful = [support for support in self.problems if coarse[support] <= _CLOSE * min(coarse.values())]
        for support in hopeful:
            self._fine(list(self.problems).index(support), support)
        losses = {support: float(self.kept.done[f"fine.{support}.loss"]) for support in hopeful}
        best = min(losses.values(), default=np.inf)
        if not np.isfinite(best):
            raise SolverError("the physics found no solution for any guess; allowed: other starts (seed) or time_step")
        near = [support for support in hopeful if losses[support] <= _CLOSE * best]
        for support in near:
            losses[support] = self._polish(list(self.problems).index(support), support, near)
        winner = min(near, key=lambda support: losses[support])
        return self._finish(winner, losses, coarse)

    def _coarse(self, number: int, support: Support) -> None:
        """Screens random guesses and descends from the best."""
        key, problem, options = f"coarse.{support}", self.problems[support], self.options
        if f"{key}.z" in self.kept.done:
            return
        problem = problem.thinned(self.chosen)
        state = self.kept.load_adam(key)
        if state is None:
            guesses = problem.coordinates.draw(options.screened, torch.Generator().manual_seed(options.seed))
            guesses = problem.fit_outline(self.coarse, guesses, (1,))
            with torch.no_grad():
                losses = problem.frame_losses(self.coarse, guesses, BLOCKS).mean(0)
            order = torch.argsort(losses, stable=True)[: options.starts]
            self._show("screen", number, support, float(losses[order[0]]), guesses[order[0]], 0.0)
            state = AdamState.at(guesses[order])

        def report(state: AdamState, losses: Tensor) -> None:
            for start, loss in enumerate(losses.tolist()):
                self._note("coarse", number * options.starts + start, loss, state.z[start], support)
            best = int(state.best_loss.argmin())
            share = state.iteration / max(options.coarse_iterations, 1)
            self._show("coarse", number, support, float(state.best_loss[best]), state.best_z[best], share)
            self.kept.save_adam(key, state)

        state = descend(
            problem,
            self.coarse,
            state,
            iterations=options.coarse_iterations,
            rate=_COARSE_RATE,
            blocks=BLOCKS,
            grow=_GROW,
            report=report,
        )
        losses = state.best_loss if options.coarse_iterations else torch.zeros(len(state.z))
        best = int(losses.argmin())
        start = np.array(number * options.starts + best)
        self.kept.end(key, {"z": state.best_z[best], "start": start, "loss": losses[best]})

    def _fine(self, number: int, support: Support) -> None:
        """Descends once more, on larger pictures."""
        key, problem, options = f"fine.{support}", self.problems[support], self.options
        if f"{key}.z" in self.kept.done:
            return
        start = int(self.kept.done[f"coarse.{support}.start"])
        state = self.kept.load_adam(key)
        if state is None:
            z = torch.from_numpy(self.kept.done[f"coarse.{support}.z"])[None]
            state = AdamState.at(problem.fit_outline(self.fine, z, (1,)))

        def report(state: AdamState, losses: Tensor) -> None:
            self._note("fine", start, float(losses[0]), state.z[0], support)
            share = state.iteration / max(options.fine_iterations, 1)
            self._show("fine", number, support, float(state.best_loss[0]), state.best_z[0], share)
            self.kept.save_adam(key, state)

        # One step more, so that the last move is judged too.
        state = descend(
            problem,
            self.fine,
            state,
            iterations=options.fine_iterations + 1,
            rate=_FINE_RATE,
            blocks=(1,),
            grow=0.0,
            report=report,
        )
        self.kept.end(key, {"z": state.best_z[0], "loss": state.best_loss[0]})

    def _polish(self, number: int, support: Support, near: list[Support]) -> float:
        """Levenberg-Marquardt, twice: the second time images and prior are in balance. The loss at the end."""
        problem, options = self.problems[support], self.options
        start = int(self.kept.done[f"coarse.{support}.start"])
        z, loss = torch.from_numpy(self.kept.done[f"fine.{support}.z"]), float(self.kept.done[f"fine.{support}.loss"])
        weight = weight_for(loss)
        for turn in range(_ROUNDS):
            key = f"polish{turn}.{support}"
            if f"{key}.z" not in self.kept.done:
                state = self.kept.load_newton(key) or NewtonState(0, z, 1e-2, weight, loss, False)

                def report(state: NewtonState, turn: int = turn, key: str = key) -> None:
                    self._note("polish", start, state.loss, state.z, support)
                    share = (
                        near.index(support) + (turn + state.iteration / options.polish_iterations) / _ROUNDS
                    ) / len(near)
                    self._show("polish", number, support, state.loss, state.z, share)
                    self.kept.save_newton(key, state)

                state = polish(problem, self.fine, state, iterations=options.polish_iterations, report=report)
                model = expand(problem, self.fine, state.z)
                dispersion = 1.0 if model is None else laplace(problem.coordinates, model, state.z, weight).dispersion
                self.kept.end(key, {"z": state.z, "loss": state.loss, "weight": weight / dispersion})
            z, loss = torch.from_numpy(self.kept.done[f"{key}.z"]), float(self.kept.done[f"{key}.loss"])
            weight = float(self.kept.done[f"{key}.weight"])
        return loss

    def _finish(self, support: Support, losses: dict[Support, float], coarse_losses: dict[Support, float]) -> Found:
        """Evaluates the optimum once more, and gathers the result."""
        problem = self.problems[support]
        last = f"polish{_ROUNDS - 1}.{support}"
        z, weight = torch.from_numpy(self.kept.done[f"{last}.z"]), float(self.kept.done[f"{last}.weight"])
        model = expand(problem, self.fine, z)
        if model is None:
            raise SolverError("the physics found no solution at the optimum; allowed: another seed or time_step")
        posterior = laplace(problem.coordinates, model, z, weight)
        n = len(self.fine.color)
        thinned, some = problem.thinned(self.chosen), self.fine.some(self.chosen)
        share = n / len(self.chosen) * weight / posterior.dispersion
        posterior = profile(thinned, some, posterior, share)
        return Found(
            support=support,
            problem=problem,
            posterior=posterior,
            loss=float(model.loss.mean()),
            poses=model.poses,
            losses=losses,
            coarse_losses=coarse_losses,
            log=self.kept.log,
            seconds=self.kept.seconds,
        )

    def _note(self, stage: str, start: int, loss: float, z: Tensor, support: Support) -> None:
        self.kept.log.add(f"{stage} {support}", start, loss, list(self._free(support, z).values()))

    def _show(self, stage: str, number: int, support: Support, loss: float, z: Tensor, share: float) -> None:
        """Reports progress; the stages take about 45, 20 and 35 % of the time."""
        count = len(self.problems)
        first, width = {"screen": (0.0, 0.0), "coarse": (0.0, 0.45), "fine": (0.45, 0.2), "polish": (0.65, 0.35)}[stage]
        place = share if stage == "polish" else (number + share) / count
        self.report(Progress(min(first + width * place, 1.0), stage, support, loss, self._free(support, z)))

    def _free(self, support: Support, z: Tensor) -> dict[str, float]:
        """Physical values of the free unknowns, in their order."""
        values = self.problems[support].coordinates.values(z)
        return {name: float(values[name]) for name in self.problems[support].coordinates.names}
