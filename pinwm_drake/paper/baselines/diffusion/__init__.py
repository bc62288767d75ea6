"""Diffusion policy: sequences of actions are drawn by taking noise away, given images and the pusher's position.

options.py         settings, with the official ones where they differ
demonstrations.py  recorded episodes on disk, and the windows of them that are learned from
collection.py      recording of episodes in which an expert succeeds
encoder.py         images to features: residual blocks, group normalisation, spatial softmax
unet.py            temporal U-Net with FiLM
network.py         both together, its loss, and how actions are drawn
actor.py           the policy: eight actions at a time, on disk as a folder of YAML and npz
method.py          the training
"""
