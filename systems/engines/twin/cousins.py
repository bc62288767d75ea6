"""Cousins as Contexts: puts theta and colours of cousins into the worlds of a WorldModel."""

from pydrake.systems.framework import Context

from pinwm_drake.cousins import Cousin, Cousins
from pinwm_drake.errors import ParameterError
from pinwm_drake.systems.engines.twin.world_model import WorldModel


def SetCousin(
    world_model: WorldModel, context: Context, cousin: Cousin, world: int | None = None, *, colors: bool = True
) -> None:
    """Makes one world a cousin; states stay as they are, and so do the other worlds.

    Args:
        world_model: Of the same twin; a station's is `station.world`.
        context: Of the world model, or of the outermost diagram around it, where there is one.
        cousin: The cousin.
        world: Which; None makes all worlds this cousin.
        colors: Whether it shall look like the cousin, too; without it takes a tenth of the time.

    Raises:
        ParameterError: The cousin's surfels are not those of the world model.
        StateError: There is no such world.
    """
    mine = world_model.GetMyMutableContextFromRoot(context)
    parameters = cousin.parameters(world_model.physics.scene)
    if world is None:
        parameters = parameters.expand(world_model.num_worlds)
    if colors:
        world_model.SetColors(mine, cousin.sh, world)
    world_model.SetParameters(mine, parameters, world)


def SetCousins(world_model: WorldModel, context: Context, cousins: Cousins) -> None:
    """Makes each world a cousin: the first the first one, and so on.

    Args:
        world_model: Of the same twin.
        context: Of the world model, or of the outermost diagram around it, where there is one.
        cousins: As many as there are worlds.

    Raises:
        ParameterError: There are more or fewer cousins than worlds, or their surfels are not those of the world model.
    """
    if len(cousins) != world_model.num_worlds:
        raise ParameterError(f"cousins: got {len(cousins)}; allowed: {world_model.num_worlds}, one for each world")
    mine = world_model.GetMyMutableContextFromRoot(context)
    world_model.SetColors(mine, cousins.sh())
    world_model.SetParameters(mine, cousins.parameters(world_model.physics.scene))
