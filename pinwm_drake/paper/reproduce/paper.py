# SPDX-License-Identifier: MIT
"""Figures of the paper's tables, to stand beside ours.

Source: Li et al., "PIN-WM: Learning physics-informed world models for non-prehensile manipulation" (RSS 2025; arXiv
2504.16693v2), tables I to VII, by way of a copy of them. Its policies have 100 actions for a push and 25 for a flip.
"""


def _by_task(rows: dict[str, tuple[str, str]]) -> dict[tuple[str, str], str]:
    """Figures of push and flip by task and row."""
    return {(task, name): pair[k] for k, task in enumerate(("push", "flip")) for name, pair in rows.items()}


POLICIES = _by_task(  # tables I and IV: success and actions; the latter has no actions
    {
        "random": ("0 %, 100", "0 %, 25"),
        "dreamer-v2": ("1 %, 99.9", "0 %, 25"),
        "diffusion-policy": ("13 %, 91.1", "10 %, 23.3"),
        "robogsim": ("19 %, 82.6", "21 %, 20.5"),
        "domain-rand": ("33 %, 73.6", "32 %, 20.0"),
        "domain-rand-2": ("56 %", "43 %"),
        "domain-rand-4": ("78 %", "61 %"),
        "2d-physics": ("55 %, 60.6", "8 %, 22.6"),
        "asid": ("58 %, 57.6", "11 %, 22.2"),
        "pin-wm-0": ("92 %, 32.1", "70 %, 12.0"),
        "pin-wm": ("97 %, 30.1", "83 %, 11.4"),
        "true-theta": ("98 %", "89 %"),
    }
)
ROBOT = _by_task(  # table III: success and actions of a real robot
    {
        "random": ("0 %, 100, a robot", "0 %, 25, a robot"),
        "domain-rand": ("10 %, 87.5, a robot", "25 %, 18.5, a robot"),
        "robogsim": ("30 %, 72.7, a robot", "15 %, 21.2, a robot"),
        "2d-physics": ("35 %, 70.7, a robot", "5 %, 24.1, a robot"),
        "asid": ("40 %, 64.6, a robot", "10 %, 22.4, a robot"),
        "pin-wm-0": ("65 %, 45.2, a robot", "60 %, 13.2, a robot"),
        "pin-wm": ("75 %, 37.5, a robot", "65 %, 11.3, a robot"),
    }
)
TASKS = {  # table VII: success of a real robot
    ("push", "pin-wm"): "45 %, a robot",
    ("push-cube", "pin-wm"): "40 %, a robot",
    ("flip-cube", "pin-wm"): "60 %, a robot",
}
ONE_STEP = _by_task(  # table II
    {
        "dreamer-v2": ("76 mm, 0.56 rad", "230 mm, 2 rad"),
        "2d-physics": ("42 mm, 0.54 rad", "210 mm, 1.6 rad"),
        "asid": ("30 mm, 0.4 rad", "140 mm, 1.6 rad"),
        "pin-wm": ("17 mm, 0.13 rad", "14 mm, 0.27 rad"),
    }
)
NOISE = _by_task(  # table VI
    {
        "0 %": ("17 mm, 0.13 rad", "14 mm, 0.27 rad"),
        "0.5 %": ("21 mm, 0.21 rad", "42 mm, 0.96 rad"),
        "1 %": ("23 mm, 0.16 rad", "42 mm, 0.95 rad"),
        "3 %": ("29 mm, 0.3 rad", "77 mm, 1.5 rad"),
    }
)
PARAMETERS = {  # table V
    (task, system, name): value
    for (system, name), values in {
        ("asid", "friction_floor"): ("0.0445", "0.259"),
        ("asid", "mass"): ("0.75", "1.36"),
        ("asid", "restitution_floor"): ("0.0112", "0.0112"),
        ("pin-wm", "friction_floor"): ("0.0305", "0.211"),
        ("pin-wm", "mass"): ("0.76", "1.19"),
        ("pin-wm", "restitution_floor"): ("0.000418", "0.0000169"),
    }.items()
    for task, value in zip(("push", "flip"), values, strict=True)
}
