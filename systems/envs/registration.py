# SPDX-License-Identifier: MIT
"""Name of the environments in gymnasium, which importing this module registers; nothing heavy is loaded for that.

    gymnasium.make(pinwm_drake.ENV_IDS["push"])                               imports this by itself
    gymnasium.make("pinwm_drake.systems.envs.registration:pinwm/Push-v0")     so does this
    import pinwm_drake.systems.envs.registration                              from here on "pinwm/Flip-v0" will do

Each known task has a name, and its recipe's scene as default; the options `scene` and `task` choose others. gymnasium
1.0 and later knows no entry points by which a package that is only installed could add a name.
"""

import gymnasium

from pinwm_drake.tasks.registry import recipe_of, task_names

ENV_IDS = {task: f"pinwm/{task.capitalize()}-v0" for task in task_names()}
"""Names of the environments in gymnasium, by task."""
for _task, _name in ENV_IDS.items():
    if _name not in gymnasium.registry:
        gymnasium.register(
            _name,
            entry_point="pinwm_drake.systems.envs.env:TaskEnv",
            # For `gymnasium.make_vec(name, num_envs=32, vectorization_mode="vector_entry_point")`.
            vector_entry_point="pinwm_drake.systems.envs.vector:TaskVectorEnv",
            kwargs={"scene": recipe_of(_task).scene},
        )
