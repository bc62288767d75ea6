# SPDX-License-Identifier: MIT
"""A station that nobody calibrated, for tests."""

from pinwm_drake.spatial.rigid import rigid, to_pose
from pinwm_drake.station.document import StationDocument
from pinwm_drake.station.view import look_at

EYE, TARGET = [0.55, -0.75, 0.6], [0.55, 0.0, 0.0]


def pose(X):
    found = to_pose(X)
    return {"p": found.p.tolist(), "q": found.q.tolist()}


def plain_station():
    """Contents of a station.yaml."""
    X_WC = look_at(EYE, [0.5, 0.05, 0.05]) @ rigid(w=[0.0, 0.0, 0.15])  # aimed aside, and rolled
    return {
        "schema_version": 1,
        "name": "mylab",
        "world": {"X_BW": pose(rigid()), "table": {"height": 0.0, "tilt": 0.0}},
        "camera": {
            "mount": "fixed",
            "size": [1280, 720],
            "model": "opencv",
            "K": [[918.3, 0.0, 652.2], [0.0, 916.9, 352.9], [0.0, 0.0, 1.0]],
            "distortion": [0.12, -0.28, 6e-4, -9e-4, 0.11],
            "X_WC": pose(X_WC),
        },
        "view": {"p_WT": TARGET, "fov_y": 0.5, "size": [64, 64]},
        "workspace": {"low": [0.4, -0.2, 0.0], "high": [0.7, 0.2, 0.12]},
    }


def station_document():
    return StationDocument.model_validate(plain_station())
