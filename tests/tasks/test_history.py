# SPDX-License-Identifier: MIT
import numpy as np

from pinwm_drake.tasks.history import begun, history_size


def test_an_episode_that_has_begun_was_always_where_it_is_and_did_nothing():
    now = np.array([[1.0, 2.0, 3.0], [4.0, 5.0, 6.0]], np.float32)
    row = begun(now, 2, 2)
    assert row.dtype == np.float32
    assert row[0].tolist() == [1, 2, 3, 1, 2, 3, 0, 0, 1, 2, 3, 0, 0]
    assert row.shape == (2, history_size(3, 2, 2))
    assert begun(now, 2, 0).tolist() == now.tolist()
    assert history_size(11, 2, 0) == 11
