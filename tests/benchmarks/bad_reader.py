# SPDX-License-Identifier: MIT
"""The child of the hardening with a reader that does what no reader may do."""

import os

import numpy as np

from benchmarks.hardening import child
from benchmarks.hardening.samples import READERS, Reader
from pinwm_drake.errors import PinwmError


class LongError(PinwmError):
    """An error of two lines."""

    def __str__(self) -> str:
        return "one\ntwo"


def read(folder):
    how = os.environ["HARDENING_TRIED"]
    if not (folder / "sample.txt").exists() or (folder / "sample.txt").read_bytes() == b"sample":
        return  # the sample itself, before anything is damaged
    if how == "hang":
        while True:
            pass
    if how == "end":
        os._exit(3)
    if how == "memory":
        np.ones(child.MOST_MEMORY // 8 + 1_000_000)
    if how == "message":
        raise LongError
    if how == "file":
        with open(os.path.join(os.environ["HOME"], "a.txt"), "w"):
            pass


READERS["bad"] = Reader(lambda folder: (folder / "sample.txt").write_bytes(b"sample"), read)
if __name__ == "__main__":
    child.main()
