# SPDX-License-Identifier: MIT
"""The adjoint of equal steps: once the state's gradient stays the same, so does what parameters gain (numba)."""

from pinwm_drake.jit import kernel

# Change of the state's gradient in a step, relative to it, below which it stays the same.
SETTLED = 1e-11


@kernel
def remember(adjoint, theta_bar):
    """Keep the gradients of the state and of the parameters before a step's adjoint."""
    kept, pairs = adjoint.kept, adjoint.kept_pairs
    mass_bar, inertia_bar, friction_bar, restitution_bar = theta_bar
    for b in range(adjoint.pose.shape[0]):
        for i in range(6):
            adjoint.kept_state[0, b, i], adjoint.kept_state[1, b, i] = adjoint.pose[b, i], adjoint.V[b, i]
    for b in range(kept.shape[0]):
        kept[b, 0] = mass_bar[b]
        for i in range(3):
            kept[b, 1 + i], kept[b, 4 + i] = adjoint.center[b, i], adjoint.spread[b, i]
            for j in range(3):
                kept[b, 7 + 3 * i + j] = inertia_bar[b, i, j]
    for k in range(pairs.shape[0]):
        pairs[k, 0], pairs[k, 1], pairs[k, 2] = friction_bar[k], restitution_bar[k], adjoint.offset[k]


@kernel
def is_settled(adjoint, nb, h):
    """Return whether the state's gradient is that from before the step, of h seconds."""
    pose, V, changed_pose, changed_V = 0.0, 0.0, 0.0, 0.0
    for b in range(nb + 1):
        for i in range(6):
            pose = max(pose, abs(adjoint.pose[b, i]))
            changed_pose = max(changed_pose, abs(adjoint.pose[b, i] - adjoint.kept_state[0, b, i]))
            if b < nb:
                V = max(V, abs(adjoint.V[b, i]))
                changed_V = max(changed_V, abs(adjoint.V[b, i] - adjoint.kept_state[1, b, i]))
    return changed_pose <= SETTLED * pose and changed_V <= SETTLED * (V + h * pose)


@kernel
def go_on(adjoint, theta_bar, times):
    """Add to the parameters' gradients what they gained since `remember`, `times` more times."""
    kept, pairs = adjoint.kept, adjoint.kept_pairs
    mass_bar, inertia_bar, friction_bar, restitution_bar = theta_bar
    for b in range(kept.shape[0]):
        mass_bar[b] += times * (mass_bar[b] - kept[b, 0])
        for i in range(3):
            adjoint.center[b, i] += times * (adjoint.center[b, i] - kept[b, 1 + i])
            adjoint.spread[b, i] += times * (adjoint.spread[b, i] - kept[b, 4 + i])
            for j in range(3):
                inertia_bar[b, i, j] += times * (inertia_bar[b, i, j] - kept[b, 7 + 3 * i + j])
    for k in range(pairs.shape[0]):
        friction_bar[k] += times * (friction_bar[k] - pairs[k, 0])
        restitution_bar[k] += times * (restitution_bar[k] - pairs[k, 1])
        adjoint.offset[k] += times * (adjoint.offset[k] - pairs[k, 2])
