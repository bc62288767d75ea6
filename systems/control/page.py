# SPDX-License-Identifier: MIT
"""Meshcat's page of a controlled station: goal, workspace, state in words, and what the policy sees."""

import math

import numpy as np
from pydrake.common.value import AbstractValue
from pydrake.geometry import Meshcat, Rgba
from pydrake.math import RigidTransform, RotationMatrix
from pydrake.systems.framework import Context, DiagramBuilder, EventStatus, LeafSystem, OutputPort
from pydrake.systems.sensors import ImageRgba8U

from pinwm_drake.control.pilot import ControlStatus
from pinwm_drake.geometry.meshes import half_diagonal, load_mesh
from pinwm_drake.report.gltf import Sheet
from pinwm_drake.report.notice import FAINT, INK, draw_notice
from pinwm_drake.report.outline import boundary, silhouette
from pinwm_drake.spatial.rotations import quaternion_to_matrix
from pinwm_drake.systems.control.controller import PolicyController
from pinwm_drake.systems.ports import unowned
from pinwm_drake.systems.scenario.setup import Setup
from pinwm_drake.systems.view.board import FIELD_OF_VIEW, Board
from pinwm_drake.systems.view.scene import PREFIX
from pinwm_drake.systems.view.sheets import show_sheets
from pinwm_drake.tasks.registry import recipe_of
from pinwm_drake.tasks.task import Task

_EVERY = 0.5  # s, between two changes of the numbers
_KEPT = 1000  # pictures of each board that a recording holds
_RAISED = 0.0005  # m, of what is drawn above the floor
_RIM = 0.003  # m, width of the goal's outline
_GOAL, _WITHIN = np.array([0.01, 0.25, 0.03]), np.array([0.45, 0.75, 0.48])  # linear RGB
_WORKSPACE = Rgba(0.45, 0.48, 0.52)
_WORDS = {
    "disarmed": ("disarmed: the pusher stays where it is", FAINT),
    "armed": ("armed: the next action moves the pusher", "#b07d1a"),
    "running": ("running: the policy moves the pusher", "#15803d"),
    "latched": ("stopped by a fault", "#c02617"),
    "done": ("done", "#2f5d9e"),
}
_TURN, _RISE = math.radians(35), math.radians(50)  # of the page's look, from the policy's camera, and above the floor
_ASIDE, _BELOW, _ABOVE = 0.95, 0.92, 0.6  # edges of the scene on the page, in halves of its height, from its middle
_LEFT, _BOTTOM = -0.49, -0.48  # edges of the boards in heights of the page, from its middle
_SIDE = 256  # thousandths of the page's height: of the picture that the policy sees


class ControlPanel(LeafSystem):  # type: ignore[misc]  # pydrake has no usable types
    """Publisher of a controller's state, in words, and of the image that the policy sees, on Meshcat's page.

                                                           ┌──────────────┐
        status        Value[ControlStatus]              ──►│              │
        rgb           ImageRgba8U                       ──►│ ControlPanel │
        object_state  (13): q_WO, p_WO [m], ω_WO, v_WO  ──►│              │
        pusher_state   (6): p_WP [m], v_WP [m/s]        ──►│              │
                                                           └──────────────┘

    Published every `period` seconds from t = 0 on, and when a publish is forced. World frame. Numbers in the words are
    told twice a second.

    Args:
        meshcat: The server.
        task: The task, whose goal and success are told.
        size: Width and height of the image, px.
        period: Simulated time between publishes, s.
        recording: Flag: the page keeps what was shown, for a recording.
        where: Object, scene and engine in words; "" leaves them out.
    """

    def __init__(
        self,
        meshcat: Meshcat,
        task: Task,
        size: tuple[int, int],
        *,
        period: float,
        recording: bool = False,
        where: str = "",
    ) -> None:
        super().__init__()
        self._task, self._where = task, where
        self._shown: list[tuple[str, str]] = []
        self._due = -math.inf  # s, when numbers are told again
        self._image = np.zeros(0, np.uint8)
        kept = _KEPT if recording else 0
        caption = draw_notice([("what the policy sees", INK)], size=20, width=_SIDE + 20, height=_SIDE + 46)
        Board(meshcat, "caption", _LEFT, _BOTTOM + 0.001 * len(caption), 0.001, behind=True).show(caption, 0.0)
        self._picture = Board(
            meshcat,
            "picture",
            _LEFT + 0.01,
            _BOTTOM + 0.001 * (_SIDE + 10),
            0.001 * _SIDE / max(size),
            kept=kept,
            sharp=True,
        )
        self._words = Board(meshcat, "words", _LEFT, -_BOTTOM, 0.001, kept=kept)
        self._status = self.DeclareAbstractInputPort("status", AbstractValue.Make(ControlStatus()))
        self._rgb = self.DeclareAbstractInputPort("rgb", AbstractValue.Make(ImageRgba8U(*size)))
        self._object = self.DeclareVectorInputPort("object_state", 13)
        self._pusher = self.DeclareVectorInputPort("pusher_state", 6)
        self.DeclarePeriodicPublishEvent(period, 0.0, unowned(self, self._Publish))
        self.DeclareForcedPublishEvent(unowned(self, self._PublishAll))

    def _PublishAll(self, context: Context) -> EventStatus:
        self._due = -math.inf
        return self._Publish(context)

    def _Publish(self, context: Context) -> EventStatus:
        status, time = self._status.Eval(context), context.get_time()
        lines = self._lines(status, self._object.Eval(context), self._pusher.Eval(context)[:3])
        # At once where the state or its reason is another one, and now and then where numbers are.
        other = lines[:2] != self._shown[:2] if status.reason else lines[:1] != self._shown[:1]
        if lines != self._shown and (other or not self._due - _EVERY < time < self._due):
            self._words.show(draw_notice(lines), time)
            self._shown, self._due = lines, time + _EVERY
        image = self._rgb.Eval(context).data
        if not np.array_equal(image, self._image):
            self._image = image.copy()
            self._picture.show(np.ascontiguousarray(image[..., :3]), time)
        return EventStatus.Succeeded()

    def _lines(self, status: ControlStatus, object_state: np.ndarray, p_WP: np.ndarray) -> list[tuple[str, str]]:
        """Lines of the page and their colours."""
        progress = self._task.measure(object_state[None], p_WP[None])
        words, colour = _WORDS[status.state]
        if progress.success[0]:
            words, colour = "at the goal", _WORDS["running"][1]
        lines = [(words, colour), *([(status.reason, colour)] if status.reason else [])]
        distance, angle = float(progress.distance[0]), float(progress.angle[0])
        if not math.isnan(distance):
            away = f"the object is {1e3 * distance:.0f} mm and {math.degrees(angle):.0f}° from the goal"
            lines.append((f"action {status.actions}: {away}", INK))
        if status.estimate:
            lines.append((f"the policy's estimate: {status.estimate}", FAINT))
        told = [self._where, recipe_of(self._task).success_words(self._task)]
        return [*lines, *((words, FAINT) for words in told if words)]


def AddControlPage(
    builder: DiagramBuilder,
    controller: PolicyController,
    rgb: OutputPort,
    object_state: OutputPort,
    pusher_state: OutputPort,
    meshcat: Meshcat,
    setup: Setup,
    *,
    engine: str,
    recording: bool = False,
    look: bool = True,
) -> ControlPanel:
    """Add what Meshcat's page of a controlled station has beside its scene.

    Args:
        builder: Builder of the diagram that holds the controller.
        controller: The controller.
        rgb: Image that the policy sees.
        object_state: State (13) of the object.
        pusher_state: State (6) of the pusher.
        meshcat: The server.
        setup: The scene.
        engine: Name of the station's engine.
        recording: Flag: the page keeps what was shown, for a recording.
        look: Flag: the page looks at the whole scene: workspace, goal, and where the object starts.
    """
    spec = controller.spec
    size = (setup.camera.width, setup.camera.height)
    where = f"{setup.twin.name} in {setup.scenario.name}, {engine}"
    panel = ControlPanel(meshcat, spec.task, size, period=spec.horizon, recording=recording, where=where)
    builder.AddNamedSystem("control_panel", panel)
    ports = {
        "status": controller.GetOutputPort("status"),
        "rgb": rgb,
        "object_state": object_state,
        "pusher_state": pusher_state,
    }
    for name, port in ports.items():
        builder.Connect(port, panel.GetInputPort(name))
    floor, limits = setup.twin.floor_height, controller.limits
    box = np.array([limits.box_low, limits.box_high])
    rim = np.array([[box[i, 0], box[j, 1], floor] for i, j in ((0, 0), (1, 0), (1, 1), (0, 1))])
    _draw_lines(meshcat, "workspace", np.stack((rim, np.roll(rim, -1, axis=0)), axis=1), 1.5, _WORKSPACE)
    _draw_goal(meshcat, spec.task, setup)
    if look:
        height = max(box[1, 2], floor + 2 * half_diagonal(load_mesh(setup.twin.mesh_path)))
        meshcat.SetCameraPose(*whole_view(np.vstack((rim, [[*rim[k, :2], height] for k in range(4)])), setup.X_WC))
    return panel


def whole_view(points: np.ndarray, X_WC: RigidTransform) -> tuple[np.ndarray, np.ndarray]:
    """Place of the page's camera, and the point that it looks at, (3,) m each, world: from there all points are seen.

    Args:
        points: (n, 3) m, world.
        X_WC: Pose of a camera, from whose right the page looks.
    """
    middle = 0.5 * (points.min(axis=0) + points.max(axis=0))
    level = RotationMatrix.MakeZRotation(_TURN) @ (X_WC.translation() - middle)
    level = level[:2] / max(float(np.linalg.norm(level[:2])), 1e-9)
    back = np.array([*(math.cos(_RISE) * level), math.sin(_RISE)])
    right = np.array([-level[1], level[0], 0.0])
    up = np.cross(back, right)
    half, offsets = math.tan(0.5 * FIELD_OF_VIEW), points - middle
    distances, shifts = [], []
    # A point at (v, w) along an axis of the page and `back` is seen at (v - shift) / (distance - w).
    for axis, low, high in ((right, _ASIDE, _ASIDE), (up, _BELOW, _ABOVE)):
        v, w, low, high = offsets @ axis, offsets @ back, half * low, half * high
        distances.append(((v + high * w).max() - (v - low * w).min()) / (low + high))
    distance = max(distances)
    for axis, low, high in ((right, _ASIDE, _ASIDE), (up, _BELOW, _ABOVE)):
        v, near, low, high = offsets @ axis, distance - offsets @ back, half * low, half * high
        shifts.append(0.5 * ((v - high * near).max() + (v + low * near).min()))
    target = middle + shifts[0] * right + shifts[1] * up
    return target + distance * back, target


def _draw_goal(meshcat: Meshcat, task: Task, setup: Setup) -> None:
    """Draw the object's outline at the goal on the floor, and the floor within it, where there is one goal."""
    path, floor = f"{PREFIX}/goal", setup.twin.floor_height
    meshcat.Delete(path)
    X_WG = task.goal_pose(floor)
    if X_WG is None:
        return
    triangles, edges = silhouette(load_mesh(setup.twin.mesh_path), quaternion_to_matrix(X_WG.q).numpy())
    ends = boundary(triangles, edges)
    along = ends[:, 1] - ends[:, 0]
    aside = np.stack((-along[:, 1], along[:, 0]), axis=1)
    aside *= 0.5 * _RIM / np.maximum(np.linalg.norm(aside, axis=1, keepdims=True), 1e-12)
    corners = np.stack([ends[:, 0] - aside, ends[:, 1] - aside, ends[:, 1] + aside, ends[:, 0] + aside], axis=1)
    rim = corners[:, [0, 1, 2, 0, 2, 3]].reshape(-1, 3, 2)
    sheets = []
    for flat, above, colour in ((triangles, _RAISED, _WITHIN), (rim, 2 * _RAISED, _GOAL)):
        points = flat.reshape(-1, 2) + X_WG.p[:2].numpy()
        vertices = np.column_stack((points, np.full(len(points), floor + above)))
        sheets.append(Sheet(vertices, np.arange(len(points)).reshape(-1, 3), np.tile(colour, (len(points), 1))))
    show_sheets(meshcat, path, sheets)


def _draw_lines(meshcat: Meshcat, name: str, segments: np.ndarray, width: float, colour: Rgba) -> None:
    """Draw segments (n, 2, 3) [m] on the floor, a number of pixels wide."""
    path, raised = f"{PREFIX}/{name}", segments + np.array([0.0, 0.0, _RAISED])
    starts, ends = np.asfortranarray(raised[:, 0].T), np.asfortranarray(raised[:, 1].T)
    meshcat.SetLineSegments(path, starts, ends, width, colour)
