# SPDX-License-Identifier: MIT
"""Restitution that gains no energy (numba).

Newton's law gives every contact its speed after a bounce, whatever friction does meanwhile; with friction, or with
several contacts at once, that can add energy. So where the bodies would gain energy in an impact, all bounces in it are
made smaller by one factor, with which they gain none.

Source: the fault is known since Kane and Levinson (1985); cf. Stronge, "Impact Mechanics" (2000), chapter 4.
"""

from pinwm_drake.jit import kernel, large_kernel, small_kernel
from pinwm_drake.physics.kernels.dynamics import IMPACT
from pinwm_drake.physics.kernels.solve import solve_again

# Steps of the search, and the work that may be lost by it, relative to that of bounces without any speed.
MOST_STEPS, NEAR = 30, 1e-6


@large_kernel
def _gain(bodies, system, contacts, work):
    """Energy that the contacts give in an impact, J: impulses times means of relative velocities."""
    total = 0.0
    for c in range(contacts.number[0]):
        lam = work.lam[c]
        if lam[0] == 0.0:
            continue
        for i in range(3):
            twice = 0.0
            for side in range(2):
                b = contacts.body[c, side]
                moves = contacts.dynamic[c, side] >= 0
                for j in range(6):
                    before = system.free[6 * b + j] if moves else bodies.V[b, j]
                    after = work.x[6 * b + j] if moves else bodies.V[b, j]
                    twice += contacts.J[c, side, i, j] * (before + after)
            total += 0.5 * lam[i] * twice
    return total


@kernel
def _bounce(contacts, share):
    """Change the share of the bounces in the biases."""
    for c in range(contacts.number[0]):
        contacts.bias[c, 0] += (contacts.elastic[0] - share) * contacts.rebound[c]
    contacts.elastic[0] = share


@large_kernel
def _bounce_less(bodies, system, contacts, work, gained):
    """Find the share of the bounces with which nothing is gained, where all of them gain something, J."""
    low, high = 0.0, contacts.elastic[0]
    _bounce(contacts, low)
    used = solve_again(bodies, system, contacts, work, IMPACT)
    lost = _gain(bodies, system, contacts, work)
    scale = abs(lost)
    for step in range(MOST_STEPS):
        if used < 0 or high - low < 1e-9 or lost >= 0.0:
            break
        # The secant's zero, and every third time the middle.
        share = 0.5 * (low + high) if step % 3 == 2 else low - lost * (high - low) / (gained - lost)
        _bounce(contacts, share)
        used = solve_again(bodies, system, contacts, work, IMPACT)
        done = _gain(bodies, system, contacts, work)
        if done > 0.0:
            high, gained = share, done
        else:
            low, lost = share, done
            if -done <= NEAR * scale:
                break
    if used >= 0 and contacts.elastic[0] != low:
        _bounce(contacts, low)
        used = solve_again(bodies, system, contacts, work, IMPACT)
    return used


@small_kernel
def bounce_passively(bodies, system, contacts, work, used):
    """Make the bounces of a solved impact smaller where they gain something; their share is contacts.elastic.

    Returns:
        Iterations used, `used` of them before; -1 where a number is not finite.
    """
    bounces = False
    for c in range(contacts.number[0]):
        bounces = bounces or (contacts.rebound[c] > 0.0 and work.lam[c, 0] > 0.0)
    if not bounces:
        return used
    gained = _gain(bodies, system, contacts, work)
    return used if gained <= 0.0 else _bounce_less(bodies, system, contacts, work, gained)
