# SPDX-License-Identifier: MIT
"""Contact forces of a plant, in the form that all engines have."""

import numpy as np
from pydrake.common.value import AbstractValue
from pydrake.multibody.plant import ContactResults, HydroelasticContactInfo, PointPairContactInfo
from pydrake.systems.framework import Context, LeafSystem

from pinwm_drake.systems.engines.engine import FLOOR_PAIR, PUSHER_PAIR, ContactForces
from pinwm_drake.systems.engines.plant.scene import ScenePlant
from pinwm_drake.systems.ports import declare_value


class PlantForces(LeafSystem):  # type: ignore[misc]  # pydrake has no usable types
    """Contact forces on the object, picked out of a plant's results.

                                          ┌─────────────┐
        contact_results  ContactResults ─►│ PlantForces │─► contact_forces  Value[ContactForces]
                                          └─────────────┘   direct feedthrough

    A hydroelastic surface is one force, at its centroid; its torque about there is left out.
    """

    def __init__(self, parts: ScenePlant) -> None:
        super().__init__()
        of_body = parts.plant.GetCollisionGeometriesForBody
        self._object, self._pusher = int(parts.object.index()), int(parts.pusher.index())
        self._object_geometries, self._pusher_geometries = set(of_body(parts.object)), set(of_body(parts.pusher))
        self._results = self.DeclareAbstractInputPort("contact_results", AbstractValue.Make(ContactResults()))
        declare_value(self, "contact_forces", ContactForces.none(), self._CalcForces, {self._results.ticket()})

    def _CalcForces(self, context: Context) -> ContactForces:
        results = self._results.Eval(context)
        points = [self._at_point(results.point_pair_contact_info(k)) for k in range(results.num_point_pair_contacts())]
        surfaces = [
            self._at_surface(results.hydroelastic_contact_info(k)) for k in range(results.num_hydroelastic_contacts())
        ]
        pairs, p_WC, f_W = zip(*points, *surfaces, strict=True) if points or surfaces else ((), (), ())
        worlds = np.zeros(len(pairs), np.int64)
        return ContactForces(worlds, pairs, np.reshape(p_WC, (-1, 3)), np.reshape(f_W, (-1, 3)))

    def _at_point(self, info: PointPairContactInfo) -> tuple[str, np.ndarray, np.ndarray]:
        """Pair, place and force on the object of a point; Drake's force is that on body B."""
        bodies = {int(info.bodyA_index()), int(info.bodyB_index())}
        sign = 1.0 if int(info.bodyB_index()) == self._object else -1.0
        pair = PUSHER_PAIR if self._pusher in bodies else FLOOR_PAIR
        return pair, info.contact_point(), sign * info.contact_force()

    def _at_surface(self, info: HydroelasticContactInfo) -> tuple[str, np.ndarray, np.ndarray]:
        """Pair, place and force on the object of a surface; Drake's force is that on the body of geometry M."""
        surface = info.contact_surface()
        sign = 1.0 if surface.id_M() in self._object_geometries else -1.0
        pair = PUSHER_PAIR if {surface.id_M(), surface.id_N()} & self._pusher_geometries else FLOOR_PAIR
        return pair, surface.centroid(), sign * info.F_Ac_W().translational()
