# SPDX-License-Identifier: MIT
"""Small scenes for the renderer's tests."""

import torch

from pinwm_drake.rendering.camera import Camera
from pinwm_drake.rendering.render import Rendering
from pinwm_drake.rendering.surfels import Surfels
from pinwm_drake.spatial.poses import Pose


def single(p=(0.0, 0.0, 0.0), q=(1.0, 0.0, 0.0, 0.0), scale=(0.02, 0.01), opacity=0.8, color=(0.9, 0.4, 0.1)):
    """One surfel of one colour in all directions."""
    return join([(p, q, scale, opacity, color)])


def join(items):
    """Surfels from (p, q, scale, opacity, color)."""
    p, q, scale, opacity, color = (torch.tensor(values, dtype=torch.float32) for values in zip(*items, strict=True))
    return Surfels(p, q, scale.log(), torch.logit(opacity), ((color - 0.5) / 0.28209479177387814)[:, None])


def cloud(number=60, degree=3, views=None, seed=1, dtype=torch.float32):
    """Random surfels of all kinds in a ball of 10 cm."""
    generator = torch.Generator().manual_seed(seed)

    def normal(*shape):
        return torch.randn(*shape, generator=generator, dtype=torch.float64)

    lead = () if views is None else (views,)
    bands = (degree + 1) ** 2
    sh = torch.cat([0.8 * normal(*lead, number, 1, 3), 0.2 * normal(*lead, number, bands - 1, 3)], -2)
    surfels = Surfels(
        0.04 * normal(number, 3), normal(number, 4), -4.5 + 0.5 * normal(number, 2), 1.0 + 1.5 * normal(number), sh
    )
    return surfels.to(dtype=dtype)


def ahead(*distances):
    """The object straight ahead, its axes those of the camera."""
    V = len(distances)
    q = torch.zeros(V, 4, dtype=torch.float64)
    q[:, 0] = 1.0
    p = torch.zeros(V, 3, dtype=torch.float64)
    p[:, 2] = torch.tensor(distances, dtype=torch.float64)
    return Pose(q, p)


def around(views, seed=0):
    """Random poses some 0.4 m away."""
    generator = torch.Generator().manual_seed(seed)
    q = torch.nn.functional.normalize(torch.randn(views, 4, generator=generator, dtype=torch.float64), dim=-1)
    p = 0.02 * torch.randn(views, 3, generator=generator, dtype=torch.float64)
    return Pose(q, p + torch.tensor([0.0, 0.0, 0.45], dtype=torch.float64))


def camera(width=45, height=37, focal=60.0):
    return Camera(width, height, torch.tensor([focal, 1.03 * focal, 0.5 * width + 0.4, 0.5 * height - 0.7]))


def parts(rendering: Rendering):
    """The images that are there, by name."""
    names = ("color", "alpha", "depth", "normal", "distortion")
    return {name: getattr(rendering, name) for name in names if getattr(rendering, name) is not None}


def leaves(surfels, X_CO):
    """The same numbers as leaves of a new graph."""
    surfels = Surfels(**{name: value.detach().clone().requires_grad_() for name, value in surfels.tensors().items()})
    return surfels, Pose(X_CO.q.clone().requires_grad_(), X_CO.p.clone().requires_grad_())


def loss(rendering, seed=3):
    """A weighted sum of every pixel of every image, so that nothing cancels."""
    generator = torch.Generator().manual_seed(seed)
    total = 0.0
    for name, image in parts(rendering).items():
        weight = torch.randn(image.shape, generator=generator, dtype=torch.float64)
        total = total + (image.double() * weight).sum() * (100.0 if name == "distortion" else 1.0)
    return total
