# SPDX-License-Identifier: MIT
"""Views of surfels: meshes, a self-contained page, a turntable, a live server."""
