"""Options of fitting surfels to images."""

from dataclasses import dataclass, fields
from typing import Literal

from pinwm_drake.errors import ParameterError
from pinwm_drake.rendering.surfels import MAX_DEGREE


@dataclass(frozen=True)
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

    iterations: int = 2500
    max_surfels: int = 5000
    first_surfels: int | None = None
    crease_share: float = 0.7
    sh_degree: int = 3
    sh_every: int = 700
    held_out: int = 4
    photometric: Literal["l1", "l2"] = "l1"
    dssim: float = 0.2
    distortion: float = 0.1
    normal: float = 0.02
    silhouette: float = 4.0
    silhouette_spread: float = 0.3
    silhouette_every: int = 2
    geometry_every: int = 10
    coarse: float = 0.1
    margin: int = 12
    rate_position: float = 5e-4
    rate_rotation: float = 2e-3
    rate_scale: float = 1e-2
    rate_opacity: float = 5e-2
    rate_color: float = 5e-3
    rate_camera: float = 0.02
    final_rate: float = 0.02
    densify_from: float = 0.02
    densify_until: float = 0.6
    densify_every: int = 100
    growth: float = 0.1
    least_opacity: float = 0.02
    evaluate_every: int = 500
    checkpoint_every: int = 500
    seed: int = 0
    num_threads: int | None = None
    backend: Literal["numba", "torch"] = "numba"

    def __post_init__(self) -> None:
        for item in fields(self):
            value, (low, high) = getattr(self, item.name), _RANGES.get(item.name, (0, 0))
            if item.name in _CHOICES:
                if value not in _CHOICES[item.name]:
                    raise ParameterError(
                        f"{item.name} is {value!r}; allowed: {' or '.join(map(repr, _CHOICES[item.name]))}"
                    )
            elif value is None and item.name in _OPTIONAL:
                continue
            elif item.name in _WHOLE and (isinstance(value, bool) or not isinstance(value, int)):
                raise ParameterError(f"{item.name} is {value!r}; allowed: a whole number")
            elif isinstance(value, bool) or not isinstance(value, int | float) or not low <= value <= high:
                raise ParameterError(f"{item.name} is {value!r}; allowed: {low} to {high}")
        if self.held_out == 1:
            raise ParameterError("held_out is 1, which leaves no view to fit; allowed: 0, or 2 and more")
        if self.first_surfels is not None and self.first_surfels > self.max_surfels:
            raise ParameterError(
                f"first_surfels is {self.first_surfels}; allowed: 1 to max_surfels = {self.max_surfels}"
            )

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


_MANY = 10_000_000
_RANGES: dict[str, tuple[float, float]] = {
    "iterations": (1, _MANY),
    "max_surfels": (1, _MANY),
    "first_surfels": (1, _MANY),
    "crease_share": (0.0, 1.0),
    "sh_degree": (0, MAX_DEGREE),
    "sh_every": (1, _MANY),
    "held_out": (0, _MANY),
    "dssim": (0.0, 1.0),
    "distortion": (0.0, 1e6),
    "normal": (0.0, 1e6),
    "silhouette": (0.0, 1e6),
    "silhouette_spread": (0.0, 3.2),
    "silhouette_every": (1, _MANY),
    "geometry_every": (1, _MANY),
    "coarse": (0.0, 1.0),
    "margin": (0, 1000),
    "rate_position": (0.0, 1.0),
    "rate_rotation": (0.0, 1.0),
    "rate_scale": (0.0, 1.0),
    "rate_opacity": (0.0, 1.0),
    "rate_color": (0.0, 1.0),
    "rate_camera": (0.0, 1.0),
    "final_rate": (1e-6, 1.0),
    "densify_from": (0.0, 1.0),
    "densify_until": (0.0, 1.0),
    "densify_every": (1, _MANY),
    "growth": (0.0, 1.0),
    "least_opacity": (0.0, 0.5),
    "evaluate_every": (0, _MANY),
    "checkpoint_every": (1, _MANY),
    "seed": (0, 2**31 - 1),
    "num_threads": (1, 1024),
}
_CHOICES = {"photometric": ("l1", "l2"), "backend": ("numba", "torch")}
_OPTIONAL = {"first_surfels", "num_threads"}
_WHOLE = {
    *(
        "iterations",
        "max_surfels",
        "first_surfels",
        "sh_degree",
        "sh_every",
        "held_out",
        "silhouette_every",
        "geometry_every",
        "margin",
    ),
    *("densify_every", "evaluate_every", "checkpoint_every", "seed", "num_threads"),
}
