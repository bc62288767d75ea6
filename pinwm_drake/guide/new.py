# SPDX-License-Identifier: MIT
"""A new lab: folders, templates, the board, and a page of what to film."""

from pathlib import Path

from pinwm_drake.files import appearing
from pinwm_drake.guide.lab import BOARD_FILE, OBJECT_FILE, LabFolder
from pinwm_drake.guide.stages import ACTS
from pinwm_drake.station.board import Board, draw_board
from pinwm_drake.station.lab import LAB_FILE, POSES_FILE, SETS
from pinwm_drake.station.photos import FIXED

FILMING_FILE = "what-to-film.md"
_LAB = """\
schema_version: 1
ruler: # m: measured length of the printed ruler of 100 mm, such as 0.0998
robot: {{length: mm, angle: deg}} # units of robot.csv
mount: fixed # camera that films pushes: it stands still
board: {board}
workspace: # m: box in which you push, in the robot's base: {{low: [0.40, -0.20, 0.0], high: [0.70, 0.20, 0.12]}}
tool: # m: pusher, such as {{shape: {{kind: cylinder, radius: 0.01, length: 0.1}}}}, or {{mesh: FILE}}
"""
_OBJECT = """\
schema_version: 1
name: object
mass:                          # kg; may stay empty
columns: ""                    # map of the log's columns as t=stamp[ms],px=x[mm],...; empty to guess it
"""


def new_lab(folder: Path) -> LabFolder:
    """Make the folder of a lab: folders for photos and films, templates, the board, and a page of what to film.

    Raises:
        InputError: There is something in the folder, or it cannot be written.
    """
    board = Board()
    with appearing(folder) as made:
        for name in (*SETS, f"photos/{FIXED}", "mesh", "pushes/0000"):
            (made / name).mkdir(parents=True)
        draw_board(board, made / BOARD_FILE)
        (made / LAB_FILE).write_text(_LAB.format(board=board.words()), encoding="utf-8")
        (made / OBJECT_FILE).write_text(_OBJECT, encoding="utf-8")
        (made / POSES_FILE).write_text("file,x,y,z,rx,ry,rz\n", encoding="utf-8")
        acts = "\n".join(f"{number}. {act}" for number, act in enumerate(ACTS, start=1))
        head = f"# What to do in this lab\n\n`pinwm lab {folder}` runs what it can, and says which act is next.\n\n"
        (made / FILMING_FILE).write_text(f"{head}{acts}\n", encoding="utf-8")
    return LabFolder(folder)
