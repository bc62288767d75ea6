# SPDX-License-Identifier: MIT
"""One push of the T-block, differentiated through every contact."""
