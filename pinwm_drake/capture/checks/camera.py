"""Check of a camera's intrinsics against the size of its images."""

from pathlib import Path

from pinwm_drake.capture.checks.findings import Findings
from pinwm_drake.rendering.camera import Camera

_OFF_CENTRE = 0.25  # of the image's size, from its middle to the principal point
_STRETCH = 0.05  # between the two focal lengths


def check_camera(path: Path, camera: Camera, findings: Findings) -> None:
    """Warns of intrinsics that may belong to images of another size.

    Args:
        path: The file of the intrinsics.
        camera: Size and intrinsics (4,).
        findings: Receives the problems.
    """
    fx, fy, cx, cy = camera.intrinsics.tolist()
    width, height = camera.width, camera.height
    if abs(cx / width - 0.5) > _OFF_CENTRE or abs(cy / height - 0.5) > _OFF_CENTRE:
        findings.warn(
            path,
            f"cx, cy = {cx:.6g}, {cy:.6g} in images of {width} x {height} px",
            "a principal point near their middle; do the intrinsics belong to another size?",
        )
    if abs(fx / fy - 1) > _STRETCH:
        findings.warn(path, f"fl_x, fl_y = {fx:.6g}, {fy:.6g}", "focal lengths that differ by 5 % at most")
