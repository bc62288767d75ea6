# SPDX-License-Identifier: MIT
"""The paper's tables: cells that are made once, each in a folder of its own, and the tables that read them."""
