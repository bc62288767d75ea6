# SPDX-License-Identifier: MIT
"""Domains as Contexts: theta and colours of cousins, or of other domains, in the worlds of a WorldModel."""

from pydrake.systems.framework import Context

from pinwm_drake.cousins.cousin import Cousin, Cousins
from pinwm_drake.errors import ParameterError
from pinwm_drake.systems.engines.twin.world_model import WorldModel


def SetDomain(
    world_model: WorldModel, context: Context, domain: Cousin, world: int | None = None, *, colors: bool = True
) -> None:
    """Give one world the theta and colours of a domain; states stay as they are, and so do the other worlds.

    Args:
        world_model: World model of the domain's twin; a station's is `station.world`.
        context: Context of the world model, or of the outermost diagram around it, where there is one.
        domain: Theta and colours, such as a cousin of the same twin.
        world: Index of the world; None for all of them.
        colors: Flag: colours are set too; without them it takes a tenth of the time.

    Raises:
        ParameterError: The domain's surfels are not those of the world model.
        StateError: There is no such world.
    """
    mine = world_model.GetMyMutableContextFromRoot(context)
    parameters = domain.parameters(world_model.physics.scene)
    if world is None:
        parameters = parameters.expand(world_model.num_worlds)
    if colors:
        world_model.SetColors(mine, domain.sh, world)
    world_model.SetParameters(mine, parameters, world)


def SetCousins(world_model: WorldModel, context: Context, cousins: Cousins) -> None:
    """Give world k the theta and colours of cousin k, for every world; states stay as they are.

    Args:
        world_model, context: World model of the cousins' twin, and a context as for `SetDomain`.
        cousins: Cousins, as many as there are worlds.

    Raises:
        ParameterError: There are more or fewer cousins than worlds, or their surfels are not those of the world model.
    """
    if len(cousins) != world_model.num_worlds:
        raise ParameterError(f"cousins: got {len(cousins)}; allowed: {world_model.num_worlds}, one for each world")
    mine = world_model.GetMyMutableContextFromRoot(context)
    world_model.SetColors(mine, cousins.sh())
    world_model.SetParameters(mine, cousins.parameters(world_model.physics.scene))
