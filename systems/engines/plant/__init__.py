# SPDX-License-Identifier: MIT
"""MultibodyPlant with hydroelastic or point contact as an engine."""
