# SPDX-License-Identifier: MIT
"""The drift that few pushes tell, where unknowns absorb a part of it."""

from dataclasses import dataclass

import pytest
import torch

from pinwm_drake.identification.discrepancy import Marginal
from pinwm_drake.identification.objective import Objective
from pinwm_drake.twin.drift import FINE_DRIFTS, chances

P, ROWS = 8, 12


@dataclass(frozen=True)
class Plain:
    """Unknowns of unit priors that all pushes share."""

    precision = torch.eye(P, dtype=torch.float64)

    def columns(self, push):
        return list(range(P))

    def penalty(self, z):
        return 0.5 * (z * z).sum(-1)

    def clamp(self, z):
        return z


@dataclass(frozen=True)
class Problem:
    coordinates = Plain()


class Linear(Objective):
    """Deviations that are linear in the unknowns, with white noise of the size of the drift's walk."""

    def __init__(self, maps, data):
        object.__setattr__(self, "problem", Problem())
        object.__setattr__(self, "expansions", [None] * len(maps))
        object.__setattr__(self, "maps", maps)
        object.__setattr__(self, "data", data)

    def deviations(self, z, push):
        return z @ self.maps[push].T - self.data[push], torch.ones(len(z), dtype=torch.bool)

    def marginal(self, push, walk, turn):
        A = torch.eye(ROWS, dtype=torch.float64) / (1e3 * walk) ** 2
        constant = float(ROWS * torch.tensor(1e3 * walk, dtype=torch.float64).log())
        return Marginal(A, torch.zeros(ROWS, dtype=torch.float64), constant, A, A[0])


@pytest.mark.parametrize("pushes", [1, 4])
def test_the_drift_has_the_evidence_of_the_data_with_the_unknowns_integrated_out(pushes):
    generator = torch.Generator().manual_seed(pushes)
    maps = [3.0 * torch.randn(ROWS, P, generator=generator, dtype=torch.float64) for _ in range(pushes)]
    truth = torch.randn(P, generator=generator, dtype=torch.float64)
    data = [J @ truth + 8.5 * torch.randn(ROWS, generator=generator, dtype=torch.float64) for J in maps]
    J, y = torch.cat(maps), torch.cat(data)
    expected = chances(FINE_DRIFTS).log()
    for k, (walk, _) in enumerate(FINE_DRIFTS):
        S = (1e3 * walk) ** 2 * torch.eye(len(y), dtype=torch.float64) + J @ J.T
        expected[k] -= 0.5 * (torch.logdet(S) + y @ torch.linalg.solve(S, y))
    found = Linear(maps, data).fine_shares(0.1 * truth)
    torch.testing.assert_close(found, torch.softmax(expected, 0), atol=1e-9, rtol=1e-6)
