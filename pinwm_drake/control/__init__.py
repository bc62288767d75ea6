# SPDX-License-Identifier: MIT
"""Control of a robot's pusher by a policy bundle, in numpy, onnx and onnxruntime alone: limits, faults, and the end."""
