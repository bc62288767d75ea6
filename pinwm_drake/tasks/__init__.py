"""Tasks: goal, success, rewards and the policy's state, which tell one task from another; no Drake, no torch.

task.py    the seam: `Task`, `Progress`, and tasks by name
push.py    an object is pushed to a pose on the floor
flip.py    an object is poked until one of its axes points up
history.py what was before a state, where policies see it
"""

from pinwm_drake.tasks.flip import FlipTask
from pinwm_drake.tasks.push import PushTask
from pinwm_drake.tasks.task import Progress, Task, default_scene, register, task_from_document

__all__ = ["FlipTask", "Progress", "PushTask", "Task", "default_scene", "register", "task_from_document"]
