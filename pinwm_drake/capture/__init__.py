"""Capture format, a robot's records of an object: read, checked and written."""

from pinwm_drake.capture.episodes import (
    Episode,
    ObjectPoses,
    PusherTrajectory,
    read_episode,
    read_episode_folder,
    read_frames,
)
from pinwm_drake.capture.objects import CaptureObject, read_capture_object
from pinwm_drake.capture.scene import Capture, PusherGeometry, PusherShape, read_capture
from pinwm_drake.capture.static_views import read_static_views, read_views
from pinwm_drake.capture.write import write_capture_yaml, write_episode_tables, write_transforms

__all__ = [
    "Capture",
    "CaptureObject",
    "Episode",
    "ObjectPoses",
    "PusherGeometry",
    "PusherShape",
    "PusherTrajectory",
    "read_capture",
    "read_capture_object",
    "read_episode",
    "read_episode_folder",
    "read_frames",
    "read_static_views",
    "read_views",
    "write_capture_yaml",
    "write_episode_tables",
    "write_transforms",
]
