# SPDX-License-Identifier: MIT
"""Cost of a step against the number of contacts, 4 to 64: the numba kernels, and the dense torch reference.

Two scenes, in which every contact presses and slips in every step:

- nails: one plate slides on a bed of n fixed balls (the pusher, at rest), n contacts of one body;
- plates: n / 4 plates slide on the floor, far apart, each on its four corners, so that the bodies grow too.
"""

import argparse
import time
from pathlib import Path

from benchmarks import results, timing
from benchmarks.scenes import push

if __name__ == "__main__":
    timing.limit_threads(1)  # before numba and torch are imported

import numpy as np
import torch
from scipy.stats import linregress

from benchmarks.scenes.pinwm_scene import inspect_path, leaves, pressing_pairs
from pinwm_drake.geometry import shapes
from pinwm_drake.physics.model import Body, Model
from pinwm_drake.physics.parameters import Parameters
from pinwm_drake.physics.state import State
from pinwm_drake.physics.stepper import Stepper

PLOT = Path(__file__).resolve().parent / "contacts.png"
_CONTACTS = (4, 8, 16, 24, 32, 40, 48, 56, 64)
_REFERENCE_CONTACTS = (4, 8, 16, 32, 64)
_STEPS = push.STEPS // 4
_REFERENCE_STEPS = 2  # the dense reference is slow, and its cost is the same in every step
_FRICTION = 0.3  # v / (mu g) = 0.346 s of sliding: longer than 80 steps, 0.333 s
_SPEED = (1.0, 0.2)  # m/s, along x and y
_BED = (2.4, 2.4, 0.02)  # m, the plate on nails
_PLATE = (0.10, 0.10, 0.02)  # m
_MASS = 1.0  # kg
_BALL = 0.01  # m, radius of a nail
_LABELS = {
    "nails_forward": "one body on n balls, forward",
    "nails_forward_backward": "one body on n balls, forward and backward",
    "plates_forward": "n / 4 bodies on the floor, forward",
    "plates_forward_backward": "n / 4 bodies on the floor, forward and backward",
    "reference": "one body on n balls, dense torch, forward",
}
_COLORS = ("tab:blue", "tab:orange", "tab:cyan", "tab:red", "tab:gray")


def _plate(name: str, size: tuple[float, float, float]) -> Body:
    x2, y2, z2 = np.square(size)
    inertia = _MASS / 12 * np.diag([y2 + z2, x2 + z2, x2 + y2])
    return Body(name=name, pieces=[shapes.box(size)], mass=_MASS, inertia=inertia)


class Sliding:
    """Scene with a given number of sliding contacts, in a few equal worlds.

    Attributes:
        model: the scene.
        worlds: number of worlds; some, so that the cost of the call itself hardly counts in 80 steps.
    """

    def __init__(self, kind: str, contacts: int, backend: str = "numba", worlds: int = 4) -> None:
        options = {"time_step": push.TIME_STEP, "max_contacts": contacts}
        if kind == "nails":
            # Two rows of balls. The plate slides by 0.17 m, its centre from -0.1 m to 0.07 m: within a sixth
            # of the rows' length (0.27 m) from their middle, so that even the farthest balls still press.
            x = np.linspace(-0.8, 0.8, contacts // 2)
            centres = [np.array([value, side, -_BALL]) for value in x for side in (-0.5, 0.5)]
            balls = [shapes.sphere(_BALL, centre) for centre in centres]
            self.model = Model([_plate("plate", _BED)], pusher=balls, floor_height=None, **options)
            p_WB = [[-0.1, 0.0, _BED[2] / 2]]
        else:
            # Apart by three times their width.
            p_WB = [[3 * _PLATE[0] * index, 0.0, _PLATE[2] / 2] for index in range(contacts // 4)]
            self.model = Model([_plate(f"plate_{index}", _PLATE) for index in range(len(p_WB))], **options)
        self.stepper = Stepper(self.model, backend=backend)
        self.worlds = worlds
        self.parameters = Parameters.nominal(
            self.model, friction_floor=_FRICTION, friction_pusher=_FRICTION, num_worlds=worlds
        )
        self.state = State.at_rest(self.model, worlds, p_WB=p_WB, V_WB=(0.0, 0.0, 0.0, *_SPEED, 0.0))

    def forward(self, steps: int) -> timing.Case:
        """Return the rollout without gradients."""
        still = self._still(steps)

        def run() -> None:
            with torch.no_grad():
                self.stepper.rollout(self.parameters, self.state, still, record_every=steps)

        return timing.Case(run, units=steps * self.worlds)

    def forward_backward(self, steps: int) -> timing.Case:
        """Return the rollout and the gradient in all parameters and the initial state."""
        still = self._still(steps)

        def run() -> None:
            end = self.stepper.rollout(leaves(self.parameters), leaves(self.state), still, record_every=steps)
            end.p_WB.square().sum().backward()

        return timing.Case(run, units=steps * self.worlds)

    def least_pressing(self, steps: int) -> int:
        """Smallest number of contacts that press in any step; one rollout, untimed."""
        still = self._still(steps)
        with torch.no_grad():
            path = self.stepper.rollout(self.parameters, self.state, still)
        reports = inspect_path(self.model, self.parameters, path, still)
        return min(len(pressing_pairs(report)) for report in reports)

    def _still(self, steps: int) -> torch.Tensor:
        return torch.zeros(steps, self.worlds, 6, dtype=torch.float64)


def fit(contacts: np.ndarray, cost: np.ndarray) -> dict[str, float]:
    """Line of least squares through cost (n,) [µs] against contacts (n,); ratio of the last cost to the first."""
    line = linregress(contacts, cost)
    r2, ratio = float(line.rvalue**2), float(cost[-1] / cost[0])
    return {"slope": float(line.slope), "intercept": float(line.intercept), "r2": r2, "ratio": ratio}


def measure(given: argparse.Namespace) -> dict:
    """Time all sizes in turn, check that all contacts press, and fit the lines.

    Raises:
        RuntimeError: a scene has fewer pressing contacts than it should: its time would mean nothing.
    """
    cases = {}
    for contacts in _CONTACTS:
        for kind in ("nails", "plates"):
            scene = Sliding(kind, contacts)
            pressing = scene.least_pressing(_STEPS)
            if pressing != contacts:
                raise RuntimeError(f"{kind}: only {pressing} of {contacts} contacts press in some step")
            cases[f"{kind}_forward", contacts] = scene.forward(_STEPS)
            cases[f"{kind}_forward_backward", contacts] = scene.forward_backward(_STEPS)
    samples = timing.interleave(cases, given.rounds, clock=time.process_time)
    for contacts in _REFERENCE_CONTACTS:
        case = Sliding("nails", contacts, "torch", worlds=1).forward(_REFERENCE_STEPS)
        samples |= timing.interleave({("reference", contacts): case}, rounds=3, warmup=1, clock=time.process_time)
    data: dict = {"series": {}}
    for name in _LABELS:
        contacts = np.array(_REFERENCE_CONTACTS if name == "reference" else _CONTACTS)
        cost = np.array([samples[name, count].median * 1e6 for count in contacts])
        data["series"][name] = {
            "contacts": contacts.tolist(),
            "microseconds": cost.round(2).tolist(),
            "line": fit(contacts, cost),
        }
    return data


def plot(data: dict) -> None:
    """Write contacts.png: the kernels and their lines; beside them all series on logarithmic axes."""
    import matplotlib

    matplotlib.use("Agg")
    import matplotlib.pyplot as plt

    figure, (left, right) = plt.subplots(1, 2, figsize=(10.0, 5.0), layout="constrained")
    for (name, label), color in zip(_LABELS.items(), _COLORS, strict=True):
        series = data["series"][name]
        contacts, cost = np.array(series["contacts"]), np.array(series["microseconds"])
        line = series["line"]
        if name != "reference":
            left.plot(contacts, line["slope"] * contacts + line["intercept"], color=color, linewidth=1)
            left.plot(contacts, cost, "o", color=color)
            label = f"{label}: {line['slope']:.2f} µs a contact, R² = {line['r2']:.4f}"
        right.loglog(contacts, cost, "o-", color=color, label=label)
    left.set(xlabel="contacts", ylabel="µs a step", ylim=(0, None), xlim=(0, None))
    ticks = [4, 8, 16, 32, 64]
    right.set(xlabel="contacts", ylabel="µs a step", xticks=ticks, xticklabels=ticks)
    right.minorticks_off()
    for axes in (left, right):
        axes.grid(alpha=0.3)
    figure.legend(loc="outside lower center", ncols=2, fontsize=8)
    figure.savefig(PLOT, dpi=130)


def table(data: dict) -> str:
    """Table of the figures, in Markdown."""
    series, rows = data["series"], []
    for name, label in _LABELS.items():
        cost = dict(zip(series[name]["contacts"], series[name]["microseconds"], strict=True))
        line = series[name]["line"]
        fitted = [f"{line['intercept']:.1f} + {line['slope']:.2f} n", f"{line['r2']:.4f}"]
        cells = [f"{cost[count]:.1f}" if count in cost else "" for count in _CONTACTS]
        rows.append([f"{label}, µs", *cells, *(fitted if name != "reference" else ("", "")), f"{line['ratio']:.1f}"])
    header = f"contacts | {' | '.join(map(str, _CONTACTS))} | line, µs | R² | cost(64) / cost(4)"
    tail = f"{data['rounds']} rounds; other processes took {data['load']:.0f} % of the CPUs."
    return "\n".join([*results.markdown(header, rows), "", tail])


if __name__ == "__main__":
    results.run("scaling", __doc__ or "", measure, table, rounds=30, plot=plot)
