# SPDX-License-Identifier: MIT
"""The surfels that a fit works on, and Adam's memory of them."""

import torch
from torch import Tensor

from pinwm_drake.rendering.fit_options import FitOptions
from pinwm_drake.rendering.surfels import Surfels

# Names of the tensors that are optimised; the first axis of all but the camera's is the surfel.
SURFEL = ("p_OS", "q_OS", "log_scale", "logit_opacity", "sh_constant", "sh_rest")
CAMERA = "camera"

# Harmonics beyond the constant learn so much slower.
_REST = 0.05


class FitState:
    """Parameters, Adam's moments, and the screen gradients that tell where surfels are missing."""

    def __init__(self, surfels: Surfels, options: FitOptions, radius: float) -> None:
        """Start a fit from surfels with harmonics of the final degree; `radius` is that of the object, m."""
        self._rates = {
            "p_OS": options.rate_position * radius,
            "q_OS": options.rate_rotation,
            "log_scale": options.rate_scale,
            "logit_opacity": options.rate_opacity,
            "sh_constant": options.rate_color,
            "sh_rest": options.rate_color * _REST,
            CAMERA: options.rate_camera,
        }
        sh = surfels.sh
        self.tensors: dict[str, Tensor] = {
            "p_OS": surfels.p_OS,
            "q_OS": torch.nn.functional.normalize(surfels.q_OS, dim=-1),
            "log_scale": surfels.log_scale,
            "logit_opacity": surfels.logit_opacity,
            "sh_constant": sh[:, :1],
            "sh_rest": sh[:, 1:],
            CAMERA: torch.zeros(2),
        }
        self.tensors = {name: value.detach().clone().contiguous() for name, value in self.tensors.items()}
        self.first = {name: torch.zeros_like(value) for name, value in self.tensors.items()}
        self.second = {name: torch.zeros_like(value) for name, value in self.tensors.items()}
        # Harmonics above the present degree take no steps yet, so each tensor counts its own.
        self.steps = {name: torch.tensor(0.0) for name in self.tensors}
        self.reset_gradients()
        self._optimise()

    @property
    def num_surfels(self) -> int:
        """Number of surfels N."""
        return int(self.tensors["p_OS"].shape[0])

    def _optimise(self) -> None:
        """Make the optimiser anew from tensors and moments."""
        groups = []
        for name, value in self.tensors.items():
            value.requires_grad_(name != CAMERA)
            groups.append({"params": [value], "lr": self._rates[name], "name": name})
        self._adam = torch.optim.Adam(groups, eps=1e-15, fused=True)
        for name, value in self.tensors.items():
            self._adam.state[value] = {
                "step": self.steps[name],
                "exp_avg": self.first[name],
                "exp_avg_sq": self.second[name],
            }

    def surfels(self, degree: int) -> Surfels:
        """Return the surfels with harmonics up to a degree, in the graph of the parameters."""
        t = self.tensors
        sh = (
            t["sh_constant"]
            if degree == 0
            else torch.cat([t["sh_constant"], t["sh_rest"][:, : (degree + 1) ** 2 - 1]], 1)
        )
        return Surfels(t["p_OS"], t["q_OS"], t["log_scale"], t["logit_opacity"], sh)

    def step(self, factor: float) -> None:
        """One step of Adam along the gradients of the tensors, which are then forgotten."""
        for group in self._adam.param_groups:
            group["lr"] = self._rates[group["name"]] * factor
        self._adam.step()
        self._adam.zero_grad(set_to_none=True)

    def reset_gradients(self) -> None:
        """Forgets the screen gradients."""
        self.screen = torch.zeros(self.num_surfels)
        self.counts = torch.zeros(self.num_surfels)

    def watch(self, screen: Tensor) -> None:
        """Add the screen gradients (N, 2) of one view, per px; surfels that it does not see do not count."""
        size = screen.norm(dim=1)
        self.screen += size
        self.counts += size > 0.0

    def replace(self, keep: Tensor, new: dict[str, Tensor]) -> None:
        """Keep some surfels, with their moments, and add others, without; forget the screen gradients.

        Args:
            keep: (N,) bool.
            new: the tensors of those to add, by name.
        """
        for name in SURFEL:
            kept = self.tensors[name].detach()[keep]
            self.tensors[name] = torch.cat([kept, new[name]])
            zeros = torch.zeros_like(new[name])
            self.first[name] = torch.cat([self.first[name][keep], zeros])
            self.second[name] = torch.cat([self.second[name][keep], zeros])
        self.reset_gradients()
        self._optimise()

    def arrays(self) -> dict[str, Tensor]:
        """State of the fit as tensors by name: everything that the next step depends on."""
        found = {"screen": self.screen, "counts": self.counts}
        for kind, tensors in self._kinds():
            found |= {f"{kind}.{name}": value.detach() for name, value in tensors.items()}
        return found

    def restore(self, arrays: dict[str, Tensor]) -> None:
        """Restores the state that `arrays` gave."""
        for kind, tensors in self._kinds():
            for name in tensors:
                tensors[name] = arrays[f"{kind}.{name}"].clone()
        self.screen, self.counts = arrays["screen"].clone(), arrays["counts"].clone()
        self._optimise()

    def _kinds(self) -> tuple[tuple[str, dict[str, Tensor]], ...]:
        return (("tensor", self.tensors), ("first", self.first), ("second", self.second), ("steps", self.steps))
