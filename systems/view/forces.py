# SPDX-License-Identifier: MIT
"""Arrows for contact forces in Meshcat, alike for every engine."""

import numpy as np
from pydrake.common.value import AbstractValue
from pydrake.geometry import Cylinder, Meshcat, MeshcatCone, Rgba
from pydrake.math import RigidTransform, RotationMatrix
from pydrake.systems.framework import Context, EventStatus, LeafSystem

from pinwm_drake.systems.engines.engine import FLOOR_PAIR, PUSHER_PAIR, ContactForces
from pinwm_drake.systems.ports import unowned

LENGTH_PER_FORCE = 0.01  # m/N
_PAIRS = {FLOOR_PAIR: ("floor", Rgba(0.10, 0.55, 0.25)), PUSHER_PAIR: ("pusher", Rgba(0.80, 0.15, 0.10))}
_SUM_RADIUS, _RADIUS = 0.0025, 0.001  # m
# Length of a head in radii of its shaft, and its share of an arrow at the most.
_HEAD, _HEAD_SHARE = 6.0, 0.5
# Shorter or longer arrows, m: the former are left out, the latter cut off.
_SHORTEST, _LONGEST = 5e-4, 0.5
_MOST = 24  # thin arrows of a pair


class MeshcatForces(LeafSystem):  # type: ignore[misc]  # pydrake has no usable types
    """Arrows for the contact forces on the object of world 0: green from the floor, red from the pusher.

                                                ┌───────────────┐
        contact_forces Value[ContactForces] ──► │ MeshcatForces │
                                                └───────────────┘

    A thick arrow is the sum of a pair's forces, at the mean of their points, each weighted by its force: engines that
    divide one contact into more or fewer points show the same. Thin ones are the forces themselves, where there are
    several; of more than 24 of a pair, the largest. An arrow starts where its force acts and is 10 mm long for each
    newton. Published every `period` seconds from t = 0 on, and when a publish is forced.

    Args:
        meshcat: The server.
        period: Simulated time between publishes, s.
        path: Path of the arrows in Meshcat's tree.
    """

    def __init__(self, meshcat: Meshcat, *, period: float, path: str) -> None:
        super().__init__()
        self._forces = self.DeclareAbstractInputPort("contact_forces", AbstractValue.Make(ContactForces.none()))
        self._arrows = {}
        for pair, (name, colour) in _PAIRS.items():
            total = _Arrow(meshcat, f"{path}/{name}/sum", _SUM_RADIUS, colour)
            each = [_Arrow(meshcat, f"{path}/{name}/{k}", _RADIUS, colour) for k in range(_MOST)]
            self._arrows[pair] = (total, each)
        self.DeclarePeriodicPublishEvent(period, 0.0, unowned(self, self._Publish))
        self.DeclareForcedPublishEvent(unowned(self, self._Publish))

    def _Publish(self, context: Context) -> EventStatus:
        forces: ContactForces = self._forces.Eval(context)
        time, pairs = context.get_time(), np.array(forces.pairs, dtype=object)
        for pair, (total, each) in self._arrows.items():
            mine = np.flatnonzero((pairs == pair) & (forces.worlds == 0))
            f_W, p_WC = forces.f_W[mine], forces.p_WC[mine]
            sizes = np.linalg.norm(f_W, axis=1)
            total.show(sizes @ p_WC / max(float(sizes.sum()), 1e-12), f_W.sum(axis=0), time)
            largest = np.argsort(-sizes, kind="stable") if len(mine) > 1 else np.zeros(0, int)
            for k, arrow in enumerate(each):
                if k < len(largest):
                    arrow.show(p_WC[largest[k]], f_W[largest[k]], time)
                else:
                    arrow.hide(time)
        return EventStatus.Succeeded()


class _Arrow:
    """Arrow of a shaft with a head. Lengths are properties: a recording keeps them, but no transform with a scale."""

    def __init__(self, meshcat: Meshcat, path: str, radius: float, colour: Rgba) -> None:
        self._meshcat, self._path, self._head = meshcat, path, _HEAD * radius
        meshcat.SetObject(f"{path}/shaft", Cylinder(radius, 1.0), colour)
        # A cone's point is its origin: turned around, and put one length ahead of the head's own origin.
        meshcat.SetObject(f"{path}/head/cone", MeshcatCone(self._head, 2 * radius, 2 * radius), colour)
        flipped = RigidTransform(RotationMatrix.MakeXRotation(np.pi), [0.0, 0.0, self._head])
        meshcat.SetTransform(f"{path}/head/cone", flipped)
        meshcat.SetProperty(path, "visible", False)

    def hide(self, time: float) -> None:
        self._meshcat.SetProperty(self._path, "visible", False, time)

    def show(self, p_WC: np.ndarray, f_W: np.ndarray, time: float) -> None:
        """Show the arrow from p_WC [m] along f_W [N], both (3,), world; hides it where the force is too small."""
        length = min(LENGTH_PER_FORCE * float(np.linalg.norm(f_W)), _LONGEST)
        if length < _SHORTEST:
            self.hide(time)
            return
        head = min(self._head, _HEAD_SHARE * length)
        shaft = length - head
        X_WA = RigidTransform(RotationMatrix.MakeFromOneVector(f_W, 2), p_WC)
        self._meshcat.SetTransform(self._path, X_WA, time)
        for part, name, value in (
            ("shaft", "scale", [1.0, 1.0, shaft]),
            ("shaft", "position", [0.0, 0.0, 0.5 * shaft]),
            ("head", "scale", [head / self._head] * 3),
            ("head", "position", [0.0, 0.0, shaft]),
        ):
            self._meshcat.SetProperty(f"{self._path}/{part}", name, value, time)
        self._meshcat.SetProperty(self._path, "visible", True, time)
