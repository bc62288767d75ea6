"""CPU milliseconds an image of an update of the network from images, in 32 bits and with bfloat16, on one core.

An update is a student's (`pinwm train`): images of 64 x 64 px are moved and dimmed, the state is estimated, its error
goes back through all layers, and Adam takes a step. Both networks begin alike. What they see is noise, which makes no
difference to the price of a convolution.
"""

import argparse
import copy
import dataclasses
import time

from benchmarks import results, timing

timing.limit_threads(1)  # before torch is imported

import torch
from torch import Tensor

from benchmarks.policy import FRAMES, SIZE, make_policy
from pinwm_drake.learning.actors import ImageActor
from pinwm_drake.learning.distil import estimation_loss
from pinwm_drake.learning.images.augment import Augment
from pinwm_drake.learning.images.bfloat16 import has_bfloat16
from pinwm_drake.learning.images.window import window_size
from pinwm_drake.learning.policy import make_actor
from pinwm_drake.learning.spec import ObjectSpec, PusherSpec, SceneSpec

BATCH, UPDATES = 256, 4


class Learner:
    """A student that learns, in one kind of numbers."""

    def __init__(self, student: ImageActor, mixed_precision: bool) -> None:
        self._student = copy.deepcopy(student)
        self._student.mixed_precision = mixed_precision
        self._optimizer = torch.optim.Adam([one for one in self._student.parameters() if one.requires_grad], 1e-3)
        self._augment = Augment(1, 0.2)

    def update(self, images: Tensor, pusher: Tensor, state: Tensor) -> None:
        """Updates of the network by one batch."""
        for _ in range(UPDATES):
            moved, factors = self._augment.drawn(images)
            found = self._student.state(moved, pusher, None, factors)
            loss = estimation_loss(found, state) + self._student.actor.imitation(found, state)
            self._optimizer.zero_grad()
            loss.backward()
            self._optimizer.step()


def make_student() -> ImageActor:
    """An untrained student as `pinwm train` makes it, with the window and head that it has by default."""
    block = ObjectSpec(name="block", mesh_sha256="0" * 64, size=(0.15, 0.15, 0.05), middle=(0.0, 0.0, 0.025))
    scene = SceneSpec(block, PusherSpec("capsule", 0.01, 0.05), floor_height=0.0)
    spec = dataclasses.replace(make_policy().spec, head="dither", width=512, scene=scene)
    student = make_actor(dataclasses.replace(spec, window=window_size(spec)))
    assert isinstance(student, ImageActor)
    student.actor.requires_grad_(False)
    return student


def table(data: dict) -> str:
    """Table of the figures, in Markdown."""
    rows = [
        [name, results.spread(each, 3), results.spread(data["ratio"], 2) if name == "bfloat16" else ""]
        for name, each in data["milliseconds"].items()
    ]
    kept = "has instructions for bfloat16" if data["instructions"] else "has none for bfloat16: trainings keep 32 bits"
    counted = f"{data['rounds']} rounds of {UPDATES} updates of {BATCH} images on one CPU, which {kept}"
    tail = f"{counted}; other processes took {data['load']:.0f} % of the CPUs."
    return "\n".join([*results.markdown("numbers | ms of CPU an image | / 32 bits", rows), "", tail])


def measure(given: argparse.Namespace) -> dict:
    """Times an update in both kinds of numbers."""
    torch.set_num_threads(1)
    student = make_student()
    images = torch.randint(0, 256, (BATCH, SIZE, SIZE, 3 * FRAMES), dtype=torch.uint8)
    pusher = 2.0 * torch.rand(BATCH, 2) - 1.0
    state = torch.randn(BATCH, student.task.state_size)
    learners = {"32 bits": Learner(student, False), "bfloat16": Learner(student, True)}

    def case(learner: Learner) -> timing.Case:
        return timing.Case(lambda: learner.update(images, pusher, state), units=UPDATES * BATCH)

    cases = {name: case(learner) for name, learner in learners.items()}
    samples = timing.interleave(cases, given.rounds, clock=time.process_time)
    return {
        "instructions": has_bfloat16(),
        "milliseconds": {name: each.summary(1e3) for name, each in samples.items()},
        "ratio": samples["bfloat16"].over(samples["32 bits"]),
    }


if __name__ == "__main__":
    results.run("mixed_precision", __doc__ or "", measure, table, rounds=20)
