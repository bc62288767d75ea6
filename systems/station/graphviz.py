# SPDX-License-Identifier: MIT
"""Pictures of the station's diagrams, as Drake describes them in Graphviz's language.

Run `python -m pinwm_drake.systems.station.graphviz docs` after a change of the station: it writes station_ENGINE.dot,
and station_ENGINE.svg where Graphviz's `dot` is installed. A test compares the text with the station.
"""

import re
import shutil
import subprocess
import sys
from pathlib import Path

from pinwm_drake.errors import InputError
from pinwm_drake.files import prepare_folder, replacing
from pinwm_drake.systems.scenario.schema import Scenario
from pinwm_drake.systems.scenario.setup import make_setup
from pinwm_drake.systems.station.station import SceneStation, make_station

PICTURED = ("twin", "hydroelastic")  # the engine "point" has the same systems as "hydroelastic"
_OBJECT = "t_block"
_EDGE = " -> "
_DEPTH = 1  # the station and its parts, whose insides are Drake's or one system
# Numbers that Drake counts up in a process, of systems and of geometry sources; and the packages of Python classes.
_COUNTED = re.compile(r"(?<![A-Za-z])(s|clusters|cluster|_|Source_)(\d+)(?=in\b|out\b|diagram\b|subsystems\b|\b|_)")
_PACKAGE = re.compile(r"(?<=<B>)pinwm_drake\.[a-z_.]+\.(?=[A-Z])")


def station_dot(station: SceneStation) -> str:
    """Text of a station in Graphviz's language; the same text for the same station in every process."""
    return plain(station.GetGraphvizString(max_depth=_DEPTH))


def plain(text: str) -> str:
    """Graphviz text of Drake's, made the same in every process.

    Numbers are counted from 0 in the order of the text, edges are sorted (Drake's order is that of addresses), and
    classes stand without their packages.
    """
    systems: dict[str, int] = {}
    sources: dict[str, int] = {}

    def count(match: re.Match[str]) -> str:
        seen = sources if match[1] == "Source_" else systems
        return f"{match[1]}{seen.setdefault(match[2], len(seen))}"

    lines = _COUNTED.sub(count, _PACKAGE.sub("", text)).rstrip().split("\n")
    edges = iter(sorted(line for line in lines if _EDGE in line))
    return "".join(f"{next(edges) if _EDGE in line else line}\n" for line in lines)


def write_pictures(folder: Path) -> list[Path]:
    """Write text and, where `dot` is installed, pictures of the stations of `PICTURED`.

    Args:
        folder: Folder of the pictures; made if need be.

    Raises:
        InputError: A file cannot be written.
    """
    setup, written = make_setup(Scenario(object=_OBJECT)), []
    prepare_folder(folder)
    for engine in PICTURED:
        text = station_dot(make_station(setup, engine))
        written.append(folder / f"station_{engine}.dot")
        with replacing(written[-1]) as partial:
            partial.write_text(text, encoding="utf-8")
        if shutil.which("dot") is not None:
            written.append(folder / f"station_{engine}.svg")
            with replacing(written[-1]) as partial:
                _draw(text, partial)
    return written


def _draw(text: str, path: Path) -> None:
    try:
        subprocess.run(["dot", "-Tsvg", "-o", str(path)], input=text, text=True, check=True, capture_output=True)
    except subprocess.CalledProcessError as error:
        raise InputError(path, value=error.stderr.strip(), allowed="what Graphviz can draw") from error


def main(arguments: list[str]) -> None:
    """Write the pictures into the folder that is given, and say which."""
    if len(arguments) != 1:
        raise SystemExit("usage: python -m pinwm_drake.systems.station.graphviz FOLDER")
    for path in write_pictures(Path(arguments[0])):
        sys.stdout.write(f"wrote {path}\n")
    if shutil.which("dot") is None:
        sys.stdout.write("no pictures, as Graphviz's `dot` is not installed\n")


if __name__ == "__main__":
    main(sys.argv[1:])
