"""Result of fitting surfels to images."""

from dataclasses import dataclass

import numpy as np

from pinwm_drake.rendering.surfels import Surfels


@dataclass(frozen=True, eq=False)
class History:
    """History of a fit, iteration by iteration.

    Attributes:
        iteration: (n,) int64, counted from 1.
        loss: (n,) float64.
        psnr: (n,) float64, PSNR of that iteration's view over its whole image, dB.
        num_surfels: (n,) int64.
        test_iteration: (m,) int64, iterations after which the held-out views were measured.
        test_psnr: (m,) float64, their mean PSNR, dB.
    """

    iteration: np.ndarray
    loss: np.ndarray
    psnr: np.ndarray
    num_surfels: np.ndarray
    test_iteration: np.ndarray
    test_psnr: np.ndarray


@dataclass(frozen=True, eq=False)
class FitResult:
    """Result of a fit: surfels, history and quality.

    Attributes:
        surfels: surfels in O, with harmonics of the chosen degree.
        history: course of the fit.
        psnr_train: PSNR of each view that was fitted, by its name, over the whole image, dB.
        psnr_test: PSNR of each held-out view, by its name, over the whole image, dB.
        camera_offset: offset that was added to cx and cy of every view, px; 0 unless rate_camera is positive.
        seconds: wall time, that of interrupted parts included.
    """

    surfels: Surfels
    history: History
    psnr_train: dict[str, float]
    psnr_test: dict[str, float]
    camera_offset: tuple[float, float]
    seconds: float
