# SPDX-License-Identifier: MIT
"""Checks of single images: intrinsics, sharpness, and agreement of the mesh's outline with the mask."""

from dataclasses import dataclass
from pathlib import Path

import cv2
import numpy as np

from pinwm_drake.capture.checks.findings import Findings
from pinwm_drake.rendering.camera import Camera

_FEWEST = 250  # px; an object seen in fewer says little
_SHARE = 0.35  # of the median sharpness; below it an image counts as blurred
_BLURRED = 0.08  # 1/px^2, of a blur of some 2.5 px
_OFF_CENTRE = 0.25  # of the image's size, from its middle to the principal point
_STRETCH = 0.05  # between the two focal lengths
_INSIDE = 2  # px from the outline, where sharpness is measured
_FEW_INSIDE = 100  # px, too few to measure it
_TOLERANCE = 1.5, 0.003  # px, or the share of the width: how far outlines may be apart
_AGREEMENT = 0.92  # of the union, away from the outlines: edges 5 % off cost 0.05 to 0.1


@dataclass(frozen=True)
class Agreement:
    """Agreement of a silhouette and a mask."""

    iou: float  # leaving out what is near the outline
    area_ratio: float  # pixels of the mask for each of the silhouette
    shift: tuple[float, float]  # px, x and y: the mask's middle from the silhouette's
    sized: bool = True  # the areas differ by less than a rim all around

    @property
    def poor(self) -> bool:
        """Flag: the agreement is too low for a mesh, scale and calibration that fit."""
        return self.iou < _AGREEMENT or not self.sized

    def words(self) -> str:
        """Overlap, ratio of areas and shift in words."""
        x, y = self.shift
        return f"overlap (IoU) {self.iou:.2f}, area x {self.area_ratio:.2f}, shift ({x:.0f}, {y:.0f}) px"


def compare(outline: np.ndarray, mask: np.ndarray, ignored: np.ndarray | None = None) -> Agreement | None:
    """Agreement of a silhouette with a mask but for ignored pixels, all (H, W) bool; None where too little is left."""
    visible = np.ones_like(mask) if ignored is None else ~ignored
    one, other = outline & visible, mask & visible
    allowed = max(_TOLERANCE[0], _TOLERANCE[1] * mask.shape[1])
    small, large = _rim(outline, round(allowed))
    counts = small == large
    union = int((counts & (one | other)).sum())
    if union < _FEW_INSIDE or not one.any() or not other.any():
        return None
    y, x = np.argwhere(other).mean(axis=0) - np.argwhere(one).mean(axis=0)
    iou, area_ratio = float((counts & one & other).sum() / union), float(other.sum() / one.sum())
    thin, wide = _rim(outline, 1)
    border = int(((wide & visible).sum() - (thin & visible).sum()) / 2)  # px^2 for each px of width
    sized = abs(int(other.sum()) - int(one.sum())) <= allowed * border
    return Agreement(iou, area_ratio, (float(x), float(y)), sized)


def _rim(outline: np.ndarray, width: int) -> tuple[np.ndarray, np.ndarray]:
    """Silhouette (H, W) bool without and with a rim of a width, px, on either side of its border."""
    kernel = cv2.getStructuringElement(cv2.MORPH_ELLIPSE, (2 * width + 1,) * 2)
    pixels = outline.astype(np.uint8)
    return cv2.erode(pixels, kernel) > 0, cv2.dilate(pixels, kernel) > 0


def sharpness(image: np.ndarray, mask: np.ndarray) -> float | None:
    """Sharpness of an object in its image (H, W, 3) float32 with mask (H, W) bool, whatever its colours and contrast.

    Returns:
        Variance of the Laplacian over that of the gradient, inside the mask, in 1/px^2: 5 to 10 for edges of a
        pixel, 0.5 after a Gaussian blur of 1 px, 0.13 after 2 px, 0.03 after 4 px. None where the mask is too
        small or the object of one colour.
    """
    inside = cv2.erode(mask.astype(np.uint8), np.ones((2 * _INSIDE + 1,) * 2, np.uint8)) > 0
    if inside.sum() < _FEW_INSIDE:
        return None
    grey = cv2.cvtColor(np.ascontiguousarray(image, np.float32), cv2.COLOR_RGB2GRAY)
    across, along = (cv2.Sobel(grey, cv2.CV_32F, *order)[inside] / 8 for order in ((1, 0), (0, 1)))
    gradient = float(across.var() + along.var())
    return float(cv2.Laplacian(grey, cv2.CV_32F)[inside].var()) / gradient if gradient > 1e-12 else None


def check_sharpness(folder: Path, values: list[tuple[Path, float | None]], findings: Findings) -> None:
    """Warns of images far less sharp than the others, and of images that are all blurred; `values` by file."""
    known = [value for _, value in values if value is not None]
    if len(known) < 4:
        return
    median = float(np.median(known))
    if median < _BLURRED:
        findings.warn(folder, f"images with a sharpness of {median:.2f}/px^2", f"{_BLURRED:g} or more: less blur")
    for path, value in values:
        if value is not None and value < _SHARE * median:
            found = f"blur: a sharpness of {value:.2f}/px^2, {value / median:.0%} of the other images'"
            findings.warn(path, found, "an image as sharp as the others")


def check_area(path: Path, mask: np.ndarray, findings: Findings) -> None:
    """Warns of an object that covers few pixels of an image; `mask` is (H, W) bool."""
    if mask.sum() < _FEWEST:
        findings.warn(path, f"an object of {mask.sum()} px", f"{_FEWEST} px or more of the object")


def check_camera(path: Path, camera: Camera, findings: Findings) -> None:
    """Warns of intrinsics in a file that may belong to images of another size."""
    fx, fy, cx, cy = camera.intrinsics.tolist()
    width, height = camera.width, camera.height
    if abs(cx / width - 0.5) > _OFF_CENTRE or abs(cy / height - 0.5) > _OFF_CENTRE:
        found = f"cx, cy = {cx:.6g}, {cy:.6g} in images of {width} x {height} px"
        findings.warn(path, found, "a principal point near their middle; do the intrinsics belong to another size?")
    if abs(fx / fy - 1) > _STRETCH:
        findings.warn(path, f"fl_x, fl_y = {fx:.6g}, {fy:.6g}", "focal lengths that differ by 5 % at most")
