# SPDX-License-Identifier: MIT
"""Ways of a pusher around an object that rests, to where an episode begins: what a further try begins with."""

import math

import numpy as np

from pinwm_drake.systems.envs.worlds import Worlds
from pinwm_drake.systems.mpc.sampling import carried_out
from pinwm_drake.systems.scenario.start import StartDistribution
from pinwm_drake.tasks.waypoints import Waypoints

_CLEAR = 0.02  # m, between pusher and object on the way
_MOST = 10  # actions
_MOVED, _MISSED = 0.002, 0.01  # m, of an object that was touched, and of a pusher that is not where it was to be


def approaches(worlds: Worlds, start: StartDistribution, generator: np.random.Generator) -> Waypoints:
    """States of pushers on their ways, and what they do there; of those that arrive and touch nothing.

    Args:
        worlds: W worlds of a task that moves the pusher in space; they are put into places of a further try.
        start: Distribution of the starts.
        generator: Source of the draws.
    """
    W = worlds.num_worlds
    worlds.begin(np.arange(W))  # for the domains
    places, ends = zip(*(start.anywhere(generator) for _ in range(W)), strict=True)
    objects, p_WP = np.array([place.object_state for place in places]), np.array([place.p_WP for place in places])
    worlds.set_object_states(objects, p_WP)
    asked, lengths = np.zeros((W, _MOST + 3, 3)), np.zeros(W, int)  # with time to arrive in
    for world, (place, end) in enumerate(zip(places, ends, strict=True)):
        points = around(place.X_WO.translation(), place.p_WP, end, worlds.run.max_translation)
        steps = np.diff(points, axis=0)[:_MOST] / worlds.run.max_translation
        asked[world, : len(steps)], lengths[world] = steps, len(steps)
    seen = [(worlds.run.object_state.copy(), worlds.run.p_WP.copy())]
    for _ in carried_out(worlds, asked):
        seen.append((worlds.run.object_state.copy(), worlds.run.p_WP.copy()))
    states, pushers = (np.array(column) for column in zip(*seen, strict=True))  # (T + 1, W, ...)
    touched = np.linalg.norm(states[-1, :, 4:7] - objects[:, 4:7], axis=1) > _MOVED
    arrived = np.linalg.norm(pushers[-1] - np.array(ends), axis=1) < _MISSED
    T, depth = len(states) - 1, worlds.actions_before
    kept = (np.arange(T)[:, None] < lengths) & arrived & ~touched
    earlier = np.concatenate([np.zeros((W, depth, 3)), asked], axis=1)
    past = np.stack([earlier[:, k : k + depth][:, ::-1] for k in range(T)])  # (T, W, depth, 3)
    return Waypoints(states[:-1][kept], pushers[:-1][kept], asked.swapaxes(0, 1)[:T][kept], past[kept])


def around(p_WO: np.ndarray, begin: np.ndarray, end: np.ndarray, longest: float) -> np.ndarray:
    """Points (n + 1, 3) m, world, on a way from `begin` to `end` around a vertical axis, `longest` [m] apart at most.

    Args:
        p_WO: (3,) m, world: a point of the axis, of an object that both ends are outside of.
        begin: (3,) m, world.
        end: (3,) m, world.
        longest: m.
    """
    away = np.array([begin, end]) - p_WO
    radii, angles = np.hypot(away[:, 0], away[:, 1]), np.arctan2(away[:, 1], away[:, 0])
    turn = math.remainder(float(angles[1] - angles[0]), 2.0 * math.pi)
    least = max(math.ceil(float(np.linalg.norm(end - begin)) / longest), math.ceil(abs(turn)), 1)
    for number in range(least, least + 100):
        shares = np.linspace(0.0, 1.0, number + 1)
        # A chord is nearer to the axis than its ends.
        clear = (radii.min() + _CLEAR) / math.cos(0.5 * turn / number)
        radius = np.maximum(radii[0] + shares * (radii[1] - radii[0]), clear)
        radius[[0, -1]] = radii
        angle = angles[0] + shares * turn
        heights = begin[2] + shares * (end[2] - begin[2])
        points = np.stack([p_WO[0] + radius * np.cos(angle), p_WO[1] + radius * np.sin(angle), heights], axis=1)
        if np.linalg.norm(np.diff(points, axis=0), axis=1).max() <= longest:
            break
    return points
