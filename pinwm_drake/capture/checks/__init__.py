# SPDX-License-Identifier: MIT
"""The checks of `pinwm capture check`, one kind a module; `pinwm_drake.capture.check` runs them."""
