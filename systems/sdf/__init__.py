# SPDX-License-Identifier: MIT
"""SDFormat, collision meshes and contact coefficients of objects, floors and pushers for Drake."""
