# SPDX-License-Identifier: MIT
"""Report of a twin: tables, frames beside the camera, the page."""
