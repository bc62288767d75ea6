# SPDX-License-Identifier: MIT
import numpy as np
import pytest
import torch
import trimesh

from pinwm_drake.geometry.meshes import load_mesh
from pinwm_drake.models import object_model
from pinwm_drake.rendering.camera import Camera
from pinwm_drake.rendering.painted import painted_surfels
from pinwm_drake.systems.scenario.viewpoints import look_at
from pinwm_drake.systems.sdf.colours import coloured_mesh
from tests.systems.vtk import picture


@pytest.mark.parametrize("name", ["t_block", "mug"])
def test_a_mesh_in_the_colours_of_surfels_looks_like_what_they_were_made_from(name, tmp_path):
    model = object_model(name)
    mesh = load_mesh(model.mesh_path)
    texts = coloured_mesh(mesh, painted_surfels(model.visual_path), "seen.mtl")
    for end, text in zip(("obj", "mtl"), texts, strict=True):
        (tmp_path / f"seen.{end}").write_text(text)
    assert texts[0].count("\nf ") <= 20000
    seen = trimesh.load_mesh(tmp_path / "seen.obj", process=False)
    assert seen.area == pytest.approx(mesh.area, rel=1e-4)
    camera, X_OC = Camera.from_field_of_view(100, 100, 0.5), look_at(np.array([0.15, -0.25, 0.3]), np.zeros(3))
    colour, _, shown = picture(model.visual_path, camera, X_OC)
    again, _, shown_again = picture(tmp_path / "seen.obj", camera, X_OC)
    assert shown.sum() > 500
    np.testing.assert_array_equal(shown, shown_again)
    difference = np.abs(colour - again)[shown].max(axis=-1)
    # Along the borders of patches of 20 mm, triangles of 3 mm have the colour of the other side.
    assert np.median(difference) < 0.05
    assert (difference > 0.2).mean() < 0.25


def test_a_colour_is_that_seen_from_straight_above():
    # One surfel whose red grows along -x: seen from +x, that is looking along -x, it is light, from -x dark.
    surfels = painted_surfels(object_model("cube").visual_path)
    sh = torch.zeros(surfels.num_surfels, 4, 3)
    sh[:, 3, 0] = 0.5
    surfels = type(surfels)(**(surfels.tensors() | {"sh": sh}))
    obj, mtl = coloured_mesh(load_mesh(object_model("cube").mesh_path), surfels, "a.mtl")
    kd = {}
    for block in mtl.split("newmtl ")[1:]:
        kd[block.split()[0]] = float(block.split("Kd ")[1].split()[0])
    corners = np.array([line.split()[1:] for line in obj.splitlines() if line.startswith("v ")], float)
    colour, found = 0.0, {1.0: [], -1.0: []}
    for line in obj.splitlines():
        if line.startswith("usemtl "):
            colour = kd[line.split()[1]]
        elif line.startswith("f "):
            points = corners[[int(corner.split("/")[0]) - 1 for corner in line.split()[1:]]]
            if np.ptp(points[:, 0]) < 1e-9 and abs(points[0, 0]) > 0.029:
                found[float(np.sign(points[0, 0]))].append(colour)
    # 1/2 + 0.4886 x 0.5
    np.testing.assert_allclose(found[1.0], 0.7443, atol=1e-3)
    np.testing.assert_allclose(found[-1.0], 0.2557, atol=1e-3)
