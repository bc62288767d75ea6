# SPDX-License-Identifier: MIT
"""Check of a whole capture, which finds all of its problems in one go."""

from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

from pinwm_drake.capture.checks.episode import check_episode
from pinwm_drake.capture.checks.findings import Findings, Problem
from pinwm_drake.capture.checks.scene import check_scene
from pinwm_drake.capture.checks.static import check_static
from pinwm_drake.capture.paths import is_folder
from pinwm_drake.capture.scene import CAPTURE_FILE, EPISODES
from pinwm_drake.errors import InputError


@dataclass(frozen=True, eq=False)
class CheckResult:
    """Problems of a capture in the order of its files, number of its static views, and of each episode's images."""

    problems: list[Problem]
    views: int
    images: dict[str, int]

    @property
    def errors(self) -> int:
        """Number of errors."""
        return sum(problem.severity == "error" for problem in self.problems)

    @property
    def warnings(self) -> int:
        """Number of warnings."""
        return len(self.problems) - self.errors


def check_capture(capture: str | Path, progress: Callable[[str], None] = lambda part: None) -> CheckResult:
    """Check a capture: every file, each by itself and against the others; `progress` is told what comes next.

    A part that others build on, such as the mesh, is left out of their checks where it is refused itself.

    Raises:
        InputError: There is no such folder.
    """
    folder = Path(capture)
    if not is_folder(folder):
        raise InputError(folder, value="no such folder", allowed=f"a capture: a folder with {CAPTURE_FILE}")
    findings = Findings(folder)
    progress(CAPTURE_FILE)
    scene = check_scene(folder, findings)
    views = check_static(scene, findings, progress)
    if not scene.episode_names:
        findings.warn(folder / EPISODES, "no episode", "one push or more, to identify a twin")
    images = {name: check_episode(name, scene, findings, progress) for name in scene.episode_names}
    return CheckResult(findings.problems, views, images)
