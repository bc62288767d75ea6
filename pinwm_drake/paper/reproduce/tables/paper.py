"""Figures of the paper's tables, to stand beside ours.

Source: Li et al., "PIN-WM: Learning physics-informed world models for non-prehensile manipulation" (RSS 2025; arXiv
2504.16693v2), tables I to VII, by way of a copy of them. Its policies have 100 actions for a push and 25 for a flip.
"""

POLICIES = {  # tables I and IV: success and actions; the latter has no actions
    ("push", "random"): "0 %, 100",
    ("push", "dreamer-v2"): "1 %, 99.9",
    ("push", "diffusion-policy"): "13 %, 91.1",
    ("push", "robogsim"): "19 %, 82.6",
    ("push", "domain-rand"): "33 %, 73.6",
    ("push", "domain-rand-2"): "56 %",
    ("push", "domain-rand-4"): "78 %",
    ("push", "2d-physics"): "55 %, 60.6",
    ("push", "asid"): "58 %, 57.6",
    ("push", "pin-wm-0"): "92 %, 32.1",
    ("push", "pin-wm"): "97 %, 30.1",
    ("push", "true-theta"): "98 %",
    ("flip", "random"): "0 %, 25",
    ("flip", "dreamer-v2"): "0 %, 25",
    ("flip", "diffusion-policy"): "10 %, 23.3",
    ("flip", "robogsim"): "21 %, 20.5",
    ("flip", "domain-rand"): "32 %, 20.0",
    ("flip", "domain-rand-2"): "43 %",
    ("flip", "domain-rand-4"): "61 %",
    ("flip", "2d-physics"): "8 %, 22.6",
    ("flip", "asid"): "11 %, 22.2",
    ("flip", "pin-wm-0"): "70 %, 12.0",
    ("flip", "pin-wm"): "83 %, 11.4",
    ("flip", "true-theta"): "89 %",
}
ROBOT = {  # table III: success and actions of a real robot
    ("push", "random"): "0 %, 100, a robot",
    ("push", "domain-rand"): "10 %, 87.5, a robot",
    ("push", "robogsim"): "30 %, 72.7, a robot",
    ("push", "2d-physics"): "35 %, 70.7, a robot",
    ("push", "asid"): "40 %, 64.6, a robot",
    ("push", "pin-wm-0"): "65 %, 45.2, a robot",
    ("push", "pin-wm"): "75 %, 37.5, a robot",
    ("flip", "random"): "0 %, 25, a robot",
    ("flip", "domain-rand"): "25 %, 18.5, a robot",
    ("flip", "robogsim"): "15 %, 21.2, a robot",
    ("flip", "2d-physics"): "5 %, 24.1, a robot",
    ("flip", "asid"): "10 %, 22.4, a robot",
    ("flip", "pin-wm-0"): "60 %, 13.2, a robot",
    ("flip", "pin-wm"): "65 %, 11.3, a robot",
}
TASKS = {  # table VII: success of a real robot
    ("push", "pin-wm"): "45 %, a robot",
    ("push-cube", "pin-wm"): "40 %, a robot",
    ("flip-cube", "pin-wm"): "60 %, a robot",
}
ONE_STEP = {  # table II
    ("push", "dreamer-v2"): "76 mm, 0.56 rad",
    ("push", "2d-physics"): "42 mm, 0.54 rad",
    ("push", "asid"): "30 mm, 0.4 rad",
    ("push", "pin-wm"): "17 mm, 0.13 rad",
    ("flip", "dreamer-v2"): "230 mm, 2 rad",
    ("flip", "2d-physics"): "210 mm, 1.6 rad",
    ("flip", "asid"): "140 mm, 1.6 rad",
    ("flip", "pin-wm"): "14 mm, 0.27 rad",
}
NOISE = {  # table VI
    ("push", "0 %"): "17 mm, 0.13 rad",
    ("push", "0.5 %"): "21 mm, 0.21 rad",
    ("push", "1 %"): "23 mm, 0.16 rad",
    ("push", "3 %"): "29 mm, 0.3 rad",
    ("flip", "0 %"): "14 mm, 0.27 rad",
    ("flip", "0.5 %"): "42 mm, 0.96 rad",
    ("flip", "1 %"): "42 mm, 0.95 rad",
    ("flip", "3 %"): "77 mm, 1.5 rad",
}
PARAMETERS = {  # table V
    ("push", "asid", "friction_floor"): "0.0445",
    ("push", "asid", "mass"): "0.75",
    ("push", "asid", "restitution_floor"): "0.0112",
    ("push", "pin-wm", "friction_floor"): "0.0305",
    ("push", "pin-wm", "mass"): "0.76",
    ("push", "pin-wm", "restitution_floor"): "0.000418",
    ("flip", "asid", "friction_floor"): "0.259",
    ("flip", "asid", "mass"): "1.36",
    ("flip", "asid", "restitution_floor"): "0.0112",
    ("flip", "pin-wm", "friction_floor"): "0.211",
    ("flip", "pin-wm", "mass"): "1.19",
    ("flip", "pin-wm", "restitution_floor"): "0.0000169",
}
