# SPDX-License-Identifier: MIT
"""Page in the output folder that shows a run while it goes on."""
