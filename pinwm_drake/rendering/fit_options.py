# SPDX-License-Identifier: MIT
"""Options of fitting surfels to images."""

from typing import Annotated, Literal

from pydantic import Field

from pinwm_drake.errors import require
from pinwm_drake.request import ADVANCED, BUDGET, DATA, option, request

_MANY = 10_000_000
_Count = Annotated[int, Field(ge=1, le=_MANY)]
_CountFrom0 = Annotated[int, Field(ge=0, le=_MANY)]
_UpToOne = Annotated[float, Field(ge=0, le=1)]
_Weight = Annotated[float, Field(ge=0, le=1e6)]


@request
class FitOptions:
    """Options of `fit`; the defaults suit an object of some 300 px, and fewer iterations do for fewer pixels.

    Attributes:
        iterations: steps of the optimiser, one view each.
        max_surfels: largest number of surfels in the end.
        first_surfels: number of surfels at the start; None for 60 % of max_surfels.
        crease_share: share of the first surfels that line the mesh's creases.
        sh_degree: degree of the spherical harmonics in the end, 0 to 3; it rises by one every sh_every iterations.
        sh_every: iterations.
        held_out: every so many-th view is kept for testing; 0 keeps none.
        photometric: "l1" or "l2", the difference of colours.
        dssim: lambda of PIN-WM eq. 7, the share of D-SSIM, 0 to 1.
        distortion: w_d, weight of the depth distortion, which is measured in object radii squared.
        normal: w_n, weight of the normal consistency.
        silhouette: weight of the difference between opacity and the outline of the mesh, from poses of which there
            is no image: training poses, turned at random by about silhouette_spread, rad. It keeps surfels from hanging
            over outlines that no image shows. 0 for a mesh that is not to be trusted.
        silhouette_every: iterations from one evaluation of the silhouette to the next.
        geometry_every: iterations from one evaluation of distortion and normal to the next, each with so many times
            the weight.
        coarse: the share of the iterations that sees images of half the size.
        margin: px around the object that the loss looks at.
        rate_position: learning rate of the centres, in object radii.
        rate_rotation, rate_scale, rate_opacity, rate_color: learning rates of quaternions, log_scale, logit_opacity
            and constant harmonics; other harmonics take a twentieth of the latter.
        rate_camera: learning rate of the principal point, px; 0 keeps it where the views say. One offset is learnt for
            all views.
        final_rate: all rates fall exponentially to this share of themselves.
        densify_from, densify_until: shares of the iterations between which surfels are added.
        densify_every: iterations.
        growth: largest number of surfels that are added each time, as a share of the surfels.
        least_opacity: surfels of less opacity are taken away.
        evaluate_every: iterations between measurements of the held-out views; 0 measures at the end only.
        checkpoint_every: iterations.
        seed: seed of the first surfels and of the order of views.
        num_threads: threads of the renderer; None for one on each core. Results are repeated bit for bit with the same
            number.
        backend: backend of `render`.

    Raises:
        ParameterError: a value is out of range; the message names it.
    """

    iterations: Annotated[int, option("Number of optimiser steps, one view each.", group=BUDGET, ge=1, le=_MANY)] = 2500
    max_surfels: Annotated[int, option("Largest number of surfels.", group=BUDGET, ge=1, le=_MANY)] = 5000
    first_surfels: _Count | None = None
    crease_share: _UpToOne = 0.7
    sh_degree: Annotated[int, option("Degree of the spherical harmonics.", group=ADVANCED, ge=0, le=3)] = 3
    sh_every: _Count = 700
    held_out: Annotated[
        int, option("Interval of the views kept for testing; 0 keeps none.", group=DATA, ge=0, le=_MANY)
    ] = 4
    photometric: Literal["l1", "l2"] = "l1"
    dssim: _UpToOne = 0.2
    distortion: _Weight = 0.1
    normal: _Weight = 0.02
    silhouette: _Weight = 4.0
    silhouette_spread: Annotated[float, Field(ge=0.0, le=3.2)] = 0.3
    silhouette_every: _Count = 2
    geometry_every: _Count = 10
    coarse: _UpToOne = 0.1
    margin: Annotated[int, Field(ge=0, le=1000)] = 12
    rate_position: _UpToOne = 5e-4
    rate_rotation: _UpToOne = 2e-3
    rate_scale: _UpToOne = 1e-2
    rate_opacity: _UpToOne = 5e-2
    rate_color: _UpToOne = 5e-3
    rate_camera: _UpToOne = 0.02
    final_rate: Annotated[float, Field(ge=1e-6, le=1.0)] = 0.02
    densify_from: _UpToOne = 0.02
    densify_until: _UpToOne = 0.6
    densify_every: _Count = 100
    growth: _UpToOne = 0.1
    least_opacity: Annotated[float, Field(ge=0.0, le=0.5)] = 0.02
    evaluate_every: _CountFrom0 = 500
    checkpoint_every: _Count = 500
    seed: Annotated[
        int, option("Seed of the first surfels and of the order of views.", group=ADVANCED, ge=0, le=2**31 - 1)
    ] = 0
    num_threads: Annotated[
        int | None, option("Number of threads.", "--threads", group=BUDGET, ge=1, le=1024, default="one a core")
    ] = None
    backend: Literal["numba", "torch"] = "numba"

    def __post_init__(self) -> None:
        require("--held-out", "1, which leaves no view to fit", self.held_out != 1, "0, or 2 and more")
        few = self.first_surfels is None or self.first_surfels <= self.max_surfels
        require("first_surfels", self.first_surfels, few, f"1 to max_surfels = {self.max_surfels}")

    def degree(self, iteration: int) -> int:
        """Degree of the harmonics in an iteration, counted from 0."""
        return min(self.sh_degree, iteration // self.sh_every)

    def rate(self, iteration: int) -> float:
        """Factor of all learning rates in an iteration, 1 at the first and `final_rate` at the last."""
        return self.final_rate ** (iteration / max(self.iterations - 1, 1))

    def densifies(self, iteration: int) -> bool:
        """Flag: surfels are added and taken away after this many iterations."""
        low, high = self.densify_from * self.iterations, self.densify_until * self.iterations
        return low <= iteration <= high and iteration % self.densify_every == 0 and iteration < self.iterations
