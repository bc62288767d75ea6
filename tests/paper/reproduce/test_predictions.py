import numpy as np
import pytest

from pinwm_drake.identification.history import History
from pinwm_drake.paper.reproduce.predictions import guesses, twin_at
from pinwm_drake.systems.scenario.load import load_setup


def history(lengths, names=("friction_floor", "moment_zz")):
    start = np.array([k for k, n in enumerate(lengths) for _ in range(n)], int)
    iteration = np.array([j for n in lengths for j in range(n)], int)
    theta = np.column_stack([0.1 + 0.01 * np.arange(len(start)), np.full(len(start), 2.0)])
    loss = np.linspace(1.0, 0.1, len(start))
    theta = theta.reshape(len(start), 2)
    return History(iteration, loss, np.array(["coarse"] * len(start)), start, theta, list(names))


def test_guesses_are_those_of_the_start_that_went_farthest():
    rows = guesses(history([5, 20, 5]))
    assert rows[0] == 5
    assert rows[-1] == 24
    assert len(rows) == 8
    assert guesses(history([3])) == [0, 1, 2]
    assert guesses(history([])) == []


def test_a_guess_is_a_twin_with_its_parameters():
    twin = load_setup("push_t").twin
    found = twin_at(twin, history([4]), 2)
    assert found.theta["friction_floor"].value == pytest.approx(0.12)
    assert found.theta["friction_pusher"] == twin.theta["friction_pusher"]
    # Twice the second moment along z alone makes the moments about x and y larger, and leaves that about z.
    assert found.theta["inertia_zz"].value == pytest.approx(twin.theta["inertia_zz"].value)
    assert found.theta["inertia_xx"].value > twin.theta["inertia_xx"].value
