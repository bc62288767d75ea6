# SPDX-License-Identifier: MIT
"""Commands on the way from a camera and photos to a capture."""
