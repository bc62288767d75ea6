# SPDX-License-Identifier: MIT
"""Report of an evaluation: figures, films of episodes, the page."""
