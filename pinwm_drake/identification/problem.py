"""The loss of W guesses of the unknowns: physics, rendering and comparison put together."""

from dataclasses import dataclass, replace

import torch
from torch import Tensor

from pinwm_drake.identification.forward import Forward
from pinwm_drake.identification.image_loss import difference, squares
from pinwm_drake.identification.pictures import Pictures
from pinwm_drake.identification.unknowns import Coordinates
from pinwm_drake.rendering.surfels import Surfels
from pinwm_drake.spatial.poses import Pose

# Guesses that are rendered at once: memory grows with it, speed hardly.
_TOGETHER = 4


@dataclass(frozen=True, eq=False)
class Problem:
    """Model that is to explain an episode: unknowns, physics and renderer.

    Attributes:
        forward: The physics, with one kind of support.
        surfels: The object's appearance, frame O.
        coordinates: The unknowns.
        num_threads: Threads of the renderer.
    """

    forward: Forward
    surfels: Surfels
    coordinates: Coordinates
    num_threads: int

    def frame_losses(self, pictures: Pictures, z: Tensor, blocks: tuple[int, ...]) -> Tensor:
        """Mean squares of every frame for W guesses.

        Args:
            pictures: The pictures to explain; n frames.
            z: (W, p).
            blocks: Sides of the blocks of pixels, px, as for `image_loss.squares`.

        Returns:
            (n, W), differentiable in z but for `outline`; infinite where the physics found no solution.
        """
        values = self.coordinates.values(z)
        X_WO, alive = self.forward.poses(values)
        parts = []
        for first in range(0, len(z), _TOGETHER):
            some = slice(first, first + _TOGETHER)
            outline = values["outline"][some].detach()
            X = Pose(X_WO.q[:, some], X_WO.p[:, some])
            parts.append(squares(difference(pictures, self.surfels, X, outline, num_threads=self.num_threads), blocks))
        losses = torch.cat(parts, -1)
        return torch.where(alive, losses, torch.inf)

    def thinned(self, chosen: Tensor) -> "Problem":
        """Copy of the problem with poses at some frames only, by their indices (m,)."""
        return replace(self, forward=replace(self.forward, chosen=chosen))

    @torch.no_grad()
    def fit_outline(self, pictures: Pictures, z: Tensor, blocks: tuple[int, ...]) -> Tensor:
        """Unknowns z with the outline's scale that suits the first frame best, where that is free.

        The renderer widens what is small, so that each resolution has a scale of its own.
        """
        if "outline" not in self.coordinates.names:
            return z
        column = self.coordinates.names.index("outline")
        first = pictures.some(torch.zeros(1, dtype=torch.long))
        X_WO = self.forward.X_WO
        guesses = torch.linspace(-25.0, 10.0, 36, dtype=torch.float64)
        trial = z[:1].expand(len(guesses), -1).clone()
        trial[:, column] = guesses
        outlines = self.coordinates.values(trial)["outline"]
        X = Pose(X_WO.q.expand(1, len(guesses), 4), X_WO.p.expand(1, len(guesses), 3))
        losses = squares(difference(first, self.surfels, X, outlines, num_threads=self.num_threads), blocks)[0]
        z = z.clone()
        z[:, column] = guesses[int(losses.argmin())]
        return self.coordinates.clamp(z)
