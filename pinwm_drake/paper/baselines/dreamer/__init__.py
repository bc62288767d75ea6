# SPDX-License-Identifier: MIT
"""Dreamer V2: a world model of images with discrete latents, and a policy that is learned in its imagination.

Source: Hafner, Lillicrap, Norouzi and Ba, "Mastering Atari with discrete world models" (ICLR 2021).
"""
