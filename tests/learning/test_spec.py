# SPDX-License-Identifier: MIT
from dataclasses import replace

import pytest

from pinwm_drake.errors import ParameterError
from tests.learning.bundles import image_spec

SPEC = image_spec(16, 1)


def with_size(size):
    return lambda: replace(SPEC, camera=replace(SPEC.camera, width=size, height=size))


@pytest.mark.parametrize(
    ("make", "message"),
    [
        (with_size(2**31), r"camera\.width: got 2147483648; allowed: 1 to 16384 px"),
        (with_size(8192), r"camera, frames: got images \(8192, 8192, 3\); allowed: 67108864 values at most"),
        (lambda: replace(SPEC, frames=2**31), r"frames: got 2147483648; allowed: 1 to 256"),
        (lambda: replace(SPEC, frames=256, camera=replace(SPEC.camera, width=512, height=512)), "camera, frames: got"),
        (lambda: replace(SPEC, width=2**31), r"width: got 2147483648; allowed: 1 to 4096"),
        (lambda: replace(SPEC, observes="state", history=10**6), "history: got 1000000; allowed: .*0 to 256"),
    ],
)
def test_a_network_that_would_take_gigabytes_is_refused(make, message):
    with pytest.raises(ParameterError, match=message):
        make()
