"""2D Gaussian Splatting on the CPU: cameras, surfels, a differentiable rasteriser, and fitting from posed images."""

from pinwm_drake.rendering.camera import Camera
from pinwm_drake.rendering.render import Rendering, narrow_disc, narrow_width, render
from pinwm_drake.rendering.surfels import Surfels

__all__ = ["Camera", "Rendering", "Surfels", "narrow_disc", "narrow_width", "render"]
