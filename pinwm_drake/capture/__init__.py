"""The capture format: what a robot records of an object, read and checked."""

from pinwm_drake.capture.objects import CaptureObject, read_capture_object
from pinwm_drake.capture.static_views import read_static_views, read_views

__all__ = ["CaptureObject", "read_capture_object", "read_static_views", "read_views"]
