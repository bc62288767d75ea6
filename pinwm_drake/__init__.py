# SPDX-License-Identifier: MIT
"""PIN-WM in Drake's idiom: calibrated digital twins of pushed objects, and policies trained in them.

    import pinwm_drake as pw

    pw.capture_path, load_capture, check_capture        a robot's records: found, read, checked
    pw.align, identify, load_twin                       surfels, theta: a twin of a capture
    pw.predict, next_push, crosscheck, draw_cousins     what a twin predicts, lacks, and is worth beside Drake's plants
    pw.load_setup, make_station, simulate, ENV_IDS      scenes as Drake diagrams and in gymnasium (pinwm/Push-v0, ...)
    pw.make_meshcat, inline_page                        Meshcat, and a page of it in a notebook
    pw.train, evaluate, export_bundle, read_bundle      policies; `TrainRequest` and `EvaluateRequest` have the options
    pw.make_control_loop, Runner                        a bundle in a station, and at a robot's own pace
    pw.Parameters, State, Stepper, twin_physics         the differentiable step
    pw.render, Camera, Surfels                          the renderer

`FitOptions`, `IdentifyOptions`, `CrossCheckOptions` and `SessionOptions` are those of align, identify, crosscheck and
simulate. Names load when they are used: the import loads neither torch, numba, pydrake nor matplotlib. `__init__.pyi`
says which module defines each; what has no name here is imported from the module that defines it.
"""

import contextlib

__version__ = "0.2.0"

with contextlib.suppress(ModuleNotFoundError):  # a checkout without dependencies has its models alone
    import lazy_loader

    __getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
