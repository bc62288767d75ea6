# SPDX-License-Identifier: MIT
import numpy as np
import pytest
import trimesh

from pinwm_drake.geometry import stored_pieces
from pinwm_drake.geometry.stored_pieces import cache_folder, mesh_pieces
from pinwm_drake.models import model_path


@pytest.fixture
def decompositions(monkeypatch, tmp_path):
    """An empty cache, and the meshes that were decomposed."""
    done = []

    def decompose(mesh):
        done.append(mesh)
        return original(mesh, threshold=0.3)

    original = stored_pieces.decompose
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path / "cache"))
    monkeypatch.setattr(stored_pieces, "decompose", decompose)
    return done


def l_shape(path):
    outline = 0.03 * np.array([(0, 0), (3, 0), (3, 1), (1, 1), (1, 3), (0, 3)], float)
    fan = np.array([(0, 1, 2), (0, 2, 3), (0, 3, 4), (0, 4, 5)])
    vertices = np.vstack([np.column_stack([outline, np.full(6, z)]) for z in (0.0, 0.05)])
    sides = [(i, (i + 1) % 6, (i + 1) % 6 + 6) for i in range(6)] + [(i, (i + 1) % 6 + 6, i + 6) for i in range(6)]
    trimesh.Trimesh(vertices, np.vstack([fan[:, ::-1], fan + 6, sides])).export(path)
    return path


def test_the_shipped_mug_has_the_pieces_beside_it(decompositions):
    pieces = mesh_pieces(model_path("mug/mug.obj"))
    assert len(pieces) == 65
    assert decompositions == []


def test_a_mesh_is_decomposed_once(decompositions, tmp_path):
    path = l_shape(tmp_path / "l.obj")
    first = mesh_pieces(path)
    assert len(first) > 1
    # The same content under another name, in another run.
    again = tmp_path / "other.obj"
    again.write_bytes(path.read_bytes())
    second = mesh_pieces(again)
    assert len(decompositions) == 1
    for one, other in zip(first, second, strict=True):
        assert np.array_equal(one.vertices, other.vertices)
    # Other content is another mesh.
    mesh = trimesh.load(path, force="mesh")
    mesh.apply_scale(1.1)
    mesh.export(again)
    mesh_pieces(again)
    assert len(decompositions) == 2


def test_a_cache_that_is_broken_or_cannot_be_written_does_no_harm(decompositions, tmp_path):
    path = l_shape(tmp_path / "l.obj")
    first = mesh_pieces(path)
    (stored,) = cache_folder().iterdir()
    stored.write_bytes(b"PK\x03\x04 half a file")
    assert len(mesh_pieces(path)) == len(first)
    assert len(decompositions) == 2
    stored.unlink()
    cache_folder().rmdir()
    cache_folder().write_text("a file where the folder should be")
    assert len(mesh_pieces(path)) == len(first)


def test_pieces_beside_a_mesh_that_are_of_another_are_not_taken(decompositions, tmp_path):
    path = l_shape(tmp_path / "l.obj")
    (tmp_path / "pieces").mkdir()
    trimesh.creation.box((0.09, 0.03, 0.05)).export(tmp_path / "pieces" / "0.obj")
    assert len(mesh_pieces(path)) > 1
    assert len(decompositions) == 1
