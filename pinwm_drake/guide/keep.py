# SPDX-License-Identifier: MIT
"""What a person made in an episode or mesh that is made anew: masks, starts, poses, files that were edited."""

import shutil
from collections.abc import Sequence
from pathlib import Path

from pinwm_drake.capture.episode_tables import FRAMES_FILE, TRAJECTORY_FILE
from pinwm_drake.experiments.masking import RECORD, read_made, sha256_of, write_made
from pinwm_drake.files import prepare_folder

MADE = ".made.json"  # in the folder of an episode or mesh: SHA-256 of each file as `pinwm lab` wrote it
_MASKS = "masks"


def keep(before: Path, now: Path) -> list[str]:
    """Copy what a person made in the folder of an episode to its new folder, whose files are recorded.

    A mask or an edited file is copied where the program makes of its image, or of itself, what it made before; other
    files are copied where the tables of images and pusher are as before.

    Args:
        before: The earlier folder; it may be missing.
        now: The new folder, as it was just made.

    Returns:
        Names of files that have no place in the new folder.
    """
    new, old, made = _hashes(now), _hashes(before), read_made(before / MADE)
    write_made(now / MADE, new)
    masked = {f"{_MASKS}/{name}": sha for name, sha in read_made(before / _MASKS / RECORD).items()}
    left = []
    for name, sha in old.items():
        if name == f"{_MASKS}/{RECORD}" or sha in (made.get(name), masked.get(name), new.get(name)):
            continue
        bases = _bases(name, [*made, *new], list(old))
        if bases and all(made.get(base, old.get(base)) == new.get(base) for base in bases):
            prepare_folder((now / name).parent)
            shutil.copy2(before / name, now / name)
        else:
            left.append(name)
    return left


def put_in_place(new: Path, path: Path, aside: Path) -> bool:
    """Give a file that was just made its name, and record it.

    Args:
        new: The file, in the folder of `path`.
        path: Its name.
        aside: New name of an earlier file that a person made or edited.

    Returns:
        Flag: there was such a file.
    """
    made, sha = read_made(path.parent / MADE), sha256_of(new)
    kept = path.is_file() and sha256_of(path) not in (sha, made.get(path.name))
    if kept:
        prepare_folder(aside.parent)
        path.replace(aside)
    new.replace(path)
    write_made(path.parent / MADE, {**made, path.name: sha})
    return kept


def _bases(name: str, made: Sequence[str], old: Sequence[str]) -> list[str]:
    """Names of the files that a file of a person belongs to."""
    if name in made:
        return [name]
    if name.startswith(f"{_MASKS}/"):
        image = Path(name).name
        return [one for one in old if one.startswith("rgb/") and image.startswith(f"{Path(one).stem}.")]
    return [FRAMES_FILE, TRAJECTORY_FILE]


def _hashes(folder: Path) -> dict[str, str]:
    """SHA-256 of the files below a folder, but for hidden ones, by their names; none where there is no folder."""
    names = [path.relative_to(folder).as_posix() for path in sorted(folder.rglob("*")) if path.is_file()]
    shown = [name for name in names if not any(part.startswith(".") for part in name.split("/"))]
    return {name: sha256_of(folder / name) for name in shown}
