"""Engines that push objects: MuJoCo, Bullet, and Drake's two contact models."""
