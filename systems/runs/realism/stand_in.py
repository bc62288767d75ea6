# SPDX-License-Identifier: MIT
"""The stand-in for a robot: a scene that is not quite the one that policies are trained in and controllers plan in."""

import dataclasses
import math
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from pydrake.common.eigen_geometry import AngleAxis, Quaternion
from pydrake.geometry import RenderEngineVtkParams
from pydrake.math import RigidTransform, RotationMatrix

from pinwm_drake.errors import InputError, require
from pinwm_drake.systems.runs.realism.lamp import draw_lamp, glossy_model
from pinwm_drake.systems.runs.realism.masks import draw_behind, ragged
from pinwm_drake.systems.runs.realism.uneven import uneven_twin
from pinwm_drake.systems.scenario.setup import Setup
from pinwm_drake.twin.twin import Twin

_OBJECT, _CAMERA, _LAMP, _MASK = range(4)  # streams of the seed


@dataclass(frozen=True)
class StandIn:
    """Numbers of the stand-in for a robot.

    Lump, feet, camera, lamp, background and the usual width of masks are those of one station and follow from `seed`;
    how masks change from image to image follows from the seed of an episode.

    Attributes:
        seed: Seed of the station, 0 or more.
        camera_place: m, by which the camera is off from where it is believed to be.
        camera_turn: rad, by which it is turned from there.
        latency: s, after which actions take effect.
        mask: px, by which an outline is wrong anywhere, at the most.
        flicker: px, standard deviation of a mask's width from one image to the next.

    Raises:
        ParameterError: A number is out of range.
    """

    seed: int = 0
    camera_place: float = 0.003
    camera_turn: float = math.radians(0.5)
    latency: float = 0.08
    mask: float = 1.0
    flicker: float = 0.3

    def __post_init__(self) -> None:
        for name in ("seed", "camera_place", "camera_turn", "latency", "mask", "flicker"):
            value = getattr(self, name)
            require(f"stand-in {name}", value, 0 <= value < math.inf, "0 or more")

    def true_scene(self, setup: Setup, models: Path) -> Setup:
        """Scene that is simulated: a lump in the object, feet below it, gloss, the camera moved, and one lamp.

        Episodes begin with the object at rest on its feet: one that would lie on any of its sides has one now.

        Args:
            setup: The scene as it is believed to be.
            models: Folder of the mesh with feet; it has to stay.

        Raises:
            InputError: The mesh cannot be used, or has no colours.
            GeometryError: No lump or no feet were found that leave the object standing.
        """
        if not setup.visual_path.with_suffix(".mtl").is_file():
            raise InputError(setup.visual_path, value="no materials", allowed="a stand-in of an object that ships")
        q_WO = np.array(setup.scenario.start.q_WO)
        up = RotationMatrix(Quaternion(wxyz=q_WO / np.linalg.norm(q_WO))).matrix()[2]
        twin = self.uneven(setup.twin, up, models)
        # Put down on another side than that of its feet, an object with a lump would be rolling as an episode begins.
        start = dataclasses.replace(setup.scenario.start, rolls=1)
        return dataclasses.replace(
            setup,
            # With the name of an object that ships, plants would take the contact meshes that ship, without feet.
            scenario=dataclasses.replace(setup.scenario, object=None, theta=None, twin=twin.name, start=start),
            twin=twin,
            visual_path=glossy_model(setup.visual_path, models),
            X_WC=self.camera(setup.X_WC),
            renderer=self.lamp(),
        )

    def uneven(self, twin: Twin, up: np.ndarray, models: Path) -> Twin:
        """Twin of the station's object: with a lump, and feet below it; see `uneven_twin`. The folder has to stay."""
        return uneven_twin(twin, up, self._generator(_OBJECT), models)

    def lamp(self) -> RenderEngineVtkParams:
        """Return the renderer with the station's lamp."""
        return draw_lamp(self._generator(_LAMP))

    def spoil(self) -> Callable[[np.ndarray, np.random.Generator], np.ndarray]:
        """Return the function that makes the mask of an image (height, width, 4) uint8 RGBA ragged."""
        station = self._generator(_MASK)
        behind, width = draw_behind(station), float(station.uniform(-0.5, 0.5)) * self.mask

        def spoilt(image: np.ndarray, generator: np.random.Generator) -> np.ndarray:
            wider = width + generator.normal(0.0, self.flicker)
            return ragged(image, wider, behind, generator, most=self.mask)

        return spoilt

    def camera(self, X_WC: RigidTransform) -> RigidTransform:
        """Pose of the station's camera, moved and turned from where it is believed to be in directions drawn evenly."""
        generator = self._generator(_CAMERA)
        along, about = (v / np.linalg.norm(v) for v in generator.normal(size=(2, 3)))
        R = RotationMatrix(AngleAxis(self.camera_turn, about))
        return RigidTransform(X_WC.rotation() @ R, X_WC.translation() + self.camera_place * along)

    def _generator(self, stream: int) -> np.random.Generator:
        return np.random.default_rng([self.seed, stream])
