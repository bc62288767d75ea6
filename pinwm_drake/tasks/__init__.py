# SPDX-License-Identifier: MIT
"""Tasks: goal, success, rewards and the policy's state, which tell one task from another; no Drake, no torch.

task.py      the seam: `Task` and `Progress`
push.py      an object is pushed to a pose on the floor
flip.py      an object is poked until one of its axes points up
recipe.py    how a task is learned, planned, filmed and checked; recipes/ has those of push and flip
registry.py  tasks and recipes by name
history.py   what was before a state, where policies see it
"""

DEFAULT_TASK = "push"
"""Name of the task where nobody names one."""
