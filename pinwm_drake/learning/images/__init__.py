# SPDX-License-Identifier: MIT
"""Images as policies learn from them: changed at random, kept, and cut out."""
