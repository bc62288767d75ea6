"""Name of the environments in gymnasium, which importing this module registers; nothing heavy is loaded for that.

    gymnasium.make("pinwm_drake.systems.envs.registration:pinwm/Push-v0")     imports this by itself
    import pinwm_drake.systems.envs.registration                              from here on "pinwm/Flip-v0" will do

The default scenes are push_t and flip_mug, with their tasks; the options `scene` and `task` choose others. gymnasium
1.0 and later knows no entry points by which a package that is only installed could add a name.
"""

import gymnasium

PUSH, FLIP = "pinwm/Push-v0", "pinwm/Flip-v0"
for _name, _scene in ((PUSH, "push_t"), (FLIP, "flip_mug")):
    if _name not in gymnasium.registry:
        gymnasium.register(
            _name,
            entry_point="pinwm_drake.systems.envs.env:TaskEnv",
            # For `gymnasium.make_vec(PUSH, num_envs=32, vectorization_mode="vector_entry_point")`.
            vector_entry_point="pinwm_drake.systems.envs.vector:TaskVectorEnv",
            kwargs={"scene": _scene},
        )
