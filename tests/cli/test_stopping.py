import os
import re
import signal
import subprocess
import sys
from pathlib import Path

import pytest

from pinwm_drake.cli.stopping import Stop, stop_signals

ROOT = Path(__file__).parents[2]


@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGTERM, signal.SIGHUP])
def test_once_deferred_a_signal_is_noted_and_the_first_one_counts(number):
    before = signal.getsignal(number)
    with stop_signals() as stop:
        stop.defer()
        assert (stop(), stop.exit_code) == ("", 0)
        os.kill(os.getpid(), number)
        os.kill(os.getpid(), signal.SIGTERM)
        assert stop.exit_code == 128 + number
        assert stop() != ""
    assert signal.getsignal(number) is before


def test_a_terminal_that_takes_nothing_is_a_wish_to_stop():
    stop = Stop()
    stop.close()
    assert (stop(), stop.exit_code) == ("a closed terminal", 129)


def test_before_that_it_ends_the_process_with_one_line():
    code = (
        "import os, signal\nfrom pinwm_drake.cli.stopping import stop_signals\n"
        "with stop_signals() as stop:\n    os.kill(os.getpid(), signal.SIGTERM)\n    print('goes on')"
    )
    end = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=False)
    assert (end.returncode, end.stderr) == (143, "")
    assert end.stdout.strip() == "stopped by SIGTERM before it was armed: nothing was moved"


# `python -m benchmarks.stopping` does it 200 times in each engine.
def test_an_armed_controller_stops_for_ctrl_c_and_sigterm_through_a_terminal():
    command = [sys.executable, "-m", "benchmarks.stopping", "--engine", "twin", "--moments", "3"]
    end = subprocess.run(command, cwd=ROOT, capture_output=True, text=True, check=False)
    assert end.returncode == 0, end.stdout + end.stderr
    assert re.search(r"^ +0  bad$", end.stdout, re.MULTILINE), end.stdout
