# SPDX-License-Identifier: MIT
"""Solids of closed shells: voids subtract, and overlaps count once."""

import warnings
from dataclasses import replace
from itertools import combinations

import manifold3d
import numpy as np
from scipy.sparse import coo_array
from scipy.sparse.csgraph import connected_components

from pinwm_drake.errors import GeometryError
from pinwm_drake.geometry.shells import Shell

_LEAST = 1e-12  # m^3
_SHARE = 1e-4  # of the smaller volume: bodies that overlap by less touch each other


def solid(shells: list[Shell]) -> list[Shell]:
    """Surface of the solid that shells bound, wound outwards.

    A shell inside another is a void, where it is wound against the smallest shell around it, and else a body. What is
    inside no other is a body, however it is wound. Voids subtract from the body around them, and bodies may stand in
    voids. Bodies that overlap count once, and so does a body in a body, of which a warning tells.

    Args:
        shells: Closed shells.

    Returns:
        Shells that bound the solid: bodies wound outwards, voids inwards. Those that neither overlap nor lie in a body
        of their own winding are the given ones.

    Raises:
        GeometryError: A shell encloses no volume, or is no surface of a solid, two that cross are wound against
            each other, or a void fills its body; the message is a phrase.
    """
    nest = _Nest(shells)
    for child, parent in enumerate(nest.parents):
        if parent is not None and nest.bodies[child] and nest.bodies[parent]:
            warnings.warn(
                f"{nest.shells[child].name} lies in {nest.shells[parent].name} and is wound as it is, so that it "
                "counts once; a void is wound the other way",
                stacklevel=2,
            )
    result = []
    for group in nest.groups():
        if nest.is_plain(group):
            result += [nest.shells[k] if nest.bodies[k] else nest.shells[k].turned() for k in group]
        else:
            result.append(nest.united(group))
    return result


def outer(shells: list[Shell]) -> list[Shell]:
    """Bodies that lie in no other shell, wound outwards: all that can be touched from outside."""
    nest = _Nest(shells)
    return [shell for shell, parent in zip(nest.shells, nest.parents, strict=True) if parent is None]


class _Nest:
    """Which shell is inside which, and what it bounds.

    Attributes:
        shells: All wound outwards.
        parents: The smallest shell around each, or None.
        bodies: Flag of each: a body, and no void.
    """

    def __init__(self, shells: list[Shell]) -> None:
        signed = np.array([shell.volume for shell in shells])
        self._volumes = np.abs(signed)
        for shell, volume in zip(shells, self._volumes, strict=True):
            if volume < _LEAST:
                raise GeometryError(f"{shell.name} without volume")
        self.shells = [shell if volume > 0.0 else shell.turned() for shell, volume in zip(shells, signed, strict=True)]
        self._manifolds: dict[int, manifold3d.Manifold] = {}
        self.parents: list[int | None] = [None] * len(shells)
        self._crossing: list[tuple[int, int]] = []
        # Larger ones first, so that of several shells around one the last is the smallest.
        order = np.argsort(-self._volumes, kind="stable")
        bounds = np.array([shell.bounds for shell in shells])
        for large, small in combinations(order.tolist(), 2):
            common = np.minimum(bounds[large, 1], bounds[small, 1]) - np.maximum(bounds[large, 0], bounds[small, 0])
            if (common <= 0.0).any() or np.prod(common) <= _SHARE * self._volumes[small]:
                continue
            shared = (self._manifold(large) ^ self._manifold(small)).volume()
            if shared >= (1.0 - _SHARE) * self._volumes[small]:
                self.parents[small] = large
            elif shared > _SHARE * self._volumes[small]:
                self._crossing.append((large, small))
        self.bodies = [True] * len(shells)
        for k in order:
            parent = self.parents[k]
            if parent is not None:
                self.bodies[k] = self.bodies[parent] == ((signed[k] > 0.0) == (signed[parent] > 0.0))
                if not self.bodies[k] and self._volumes[k] >= (1.0 - _SHARE) * self._volumes[parent]:
                    raise GeometryError(f"{shells[k].name}, a void that fills {shells[parent].name}")
        for pair in self._crossing:
            if all(self.parents[k] is None for k in pair) and np.prod(np.sign(signed[list(pair)])) < 0:
                names = " and ".join(shells[k].name for k in sorted(pair))
                raise GeometryError(f"{names}, which cross and are wound against each other")

    def groups(self) -> list[list[int]]:
        """Shells that overlap or lie in each other, in the order of the first of each."""
        pairs = self._crossing + [(k, parent) for k, parent in enumerate(self.parents) if parent is not None]
        links = np.array(pairs, int).reshape(-1, 2).T
        count = len(self.shells)
        _, label = connected_components(coo_array((np.ones(len(pairs)), (links[0], links[1])), shape=(count, count)))
        return [np.flatnonzero(label == number).tolist() for number in dict.fromkeys(label.tolist())]

    def is_plain(self, group: list[int]) -> bool:
        """Flag: the shells bound the solid as they are, as none overlap and bodies and voids take turns."""
        crossing = any(k in group for pair in self._crossing for k in pair)
        return not crossing and all(
            parent is None or self.bodies[k] != self.bodies[parent]
            for k, parent in ((k, self.parents[k]) for k in group)
        )

    def united(self, group: list[int]) -> Shell:
        """Union of the bodies of a group, each without the voids in it."""
        combine = manifold3d.Manifold.batch_boolean
        bodies = []
        for k in group:
            if self.bodies[k]:
                voids = [self._manifold(j) for j in group if self.parents[j] == k and not self.bodies[j]]
                bodies.append(combine([self._manifold(k), *voids], manifold3d.OpType.Subtract))
        mesh = combine(bodies, manifold3d.OpType.Add).to_mesh64()
        vertices, faces = np.array(mesh.vert_properties[:, :3]), np.array(mesh.tri_verts, int)
        return replace(self.shells[group[0]], vertices=vertices, faces=faces)

    def _manifold(self, k: int) -> manifold3d.Manifold:
        if k not in self._manifolds:
            shell = self.shells[k]
            vertices = np.ascontiguousarray(shell.vertices, np.float64)
            made = manifold3d.Manifold(manifold3d.Mesh64(vertices, np.ascontiguousarray(shell.faces, np.uint64)))
            if made.status() != manifold3d.Error.NoError:
                raise GeometryError(f"{shell.name}, which is no surface of a solid ({made.status().name})")
            self._manifolds[k] = made
        return self._manifolds[k]
