# SPDX-License-Identifier: MIT
"""A container: the root is read-only, one folder can be written to, and the user has no name and no home."""

import functools
import shutil
import subprocess
import sys
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parents[1]
USER = 12345
# Inner users see what is mounted for them only; a bound folder keeps its own options when others are made read-only.
_SCRIPT = """
set -e
volume=$1; shift
mount --bind "$volume" "$volume"
cut -d" " -f5 /proc/self/mountinfo | while read -r point; do
  case "$point" in
    "$volume"|/proc|/proc/*|/sys|/sys/*|/dev|/dev/*) ;;
    *) mount -o remount,bind,ro "$point" 2>/dev/null || mount -o remount,bind,ro,nosuid,nodev "$point" ;;
  esac
done
cd "$volume"
exec unshare --user --map-user=12345 --map-group=12345 "$@"
"""


@functools.cache
def lacking() -> str:
    """Reason why this machine has no such container; "" where it has."""
    if shutil.which("unshare") is None:
        return "no unshare on this machine"
    try:
        done = _start(Path("/tmp"), ["sh", "-c", "id -u; ! touch /x"], 60.0)
    except subprocess.TimeoutExpired:
        return "unshare gives no answer"
    told = f"{done.stdout}{done.stderr}".split("\n")
    return (
        "" if done.returncode == 0 and told[0] == str(USER) else f"unshare: {told[-2] if len(told) > 1 else 'refused'}"
    )


def run(volume: Path, *command: str, timeout: float = 600.0, **variables: str) -> subprocess.CompletedProcess[str]:
    """Run `python -c` of the command line in the container, with `volume` as working folder; skips where it cannot."""
    if reason := lacking():
        pytest.skip(reason)
    inner = [sys.executable, "-c", "from pinwm_drake.cli import main; main()", *command]
    return _start(volume, inner, timeout, **variables)


def _start(volume: Path, inner: list[str], timeout: float, **variables: str) -> subprocess.CompletedProcess[str]:
    clean = {"PATH": "/usr/bin:/bin:/usr/sbin:/sbin", "PYTHONPATH": str(ROOT), "LC_ALL": "C", **variables}
    command = ["unshare", "--user", "--map-root-user", "--mount", "sh", "-c", _SCRIPT, "sh", str(volume), *inner]
    coding = variables.get("PYTHONIOENCODING", "utf-8")
    return subprocess.run(command, env=clean, capture_output=True, encoding=coding, timeout=timeout, check=False)
