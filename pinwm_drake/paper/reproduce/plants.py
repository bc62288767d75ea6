"""Plants in which episodes are recorded: those that policies are tried in."""

from pathlib import Path

from pinwm_drake.files import prepare_folder
from pinwm_drake.systems.envs.env import changed_options
from pinwm_drake.systems.envs.options import EnvOptions
from pinwm_drake.systems.envs.vector import TaskVecEnv
from pinwm_drake.systems.runs.realism.stand_in import StandIn
from pinwm_drake.systems.scenario.setup import Setup


def recording_plant(setup: Setup, options: EnvOptions, folder: Path, *, stand_in: bool) -> TaskVecEnv:
    """Drake's hydroelastic plant of a scene as one world for Stable-Baselines3.

    Args:
        setup: The scene as it is believed to be.
        options: Options of the environment.
        folder: Folder for meshes of a stand-in; it has to stay.
        stand_in: Flag: the stand-in for a robot, with its camera, light, masks and late actions.

    Raises:
        InputError: A file of the scene cannot be used.
        ParameterError: An option is none of those allowed.
    """
    if not stand_in:
        return TaskVecEnv(setup, 1, options, engine="hydroelastic")
    station = StandIn()
    options = changed_options(options, {"latency": (station.latency, station.latency)})
    env = TaskVecEnv(station.true_scene(setup, prepare_folder(folder)), 1, options, engine="hydroelastic")
    env.worlds.spoil = station.spoil()
    return env
