# SPDX-License-Identifier: MIT
import pytest

from pinwm_drake.errors import StateError
from pinwm_drake.systems.cameras import object_camera


def test_a_camera_of_a_fork_is_refused_where_its_parent_has_rendered(monkeypatch):
    monkeypatch.setattr(object_camera, "_renderer_process", None)
    object_camera._require_own_renderer()
    object_camera._require_own_renderer()
    monkeypatch.setattr(object_camera.os, "getpid", lambda: -1)
    with pytest.raises(StateError, match='allowed: context="spawn" or "forkserver"'):
        object_camera._require_own_renderer()
