# SPDX-License-Identifier: MIT
import contextlib
import os
import pty
import signal
import subprocess
import sys

import pytest

from pinwm_drake.cli.stopping import Stop, stop_signals


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


@pytest.mark.parametrize("number", [signal.SIGINT, pytest.param(signal.SIGTERM, marks=pytest.mark.nightly)])
def test_an_armed_controller_stops_for_ctrl_c_and_sigterm_through_a_terminal(number):
    pid, terminal = pty.fork()
    if pid == 0:
        code = "import sys\nfrom pinwm_drake.cli import main\nmain()"
        os.execv(sys.executable, [sys.executable, "-c", code, "control", "push_t", "--arm", "--engine", "twin"])
    output = b""
    with contextlib.suppress(OSError):  # where the process has ended
        while b": the pusher moves" not in output:
            output += os.read(terminal, 4096)
        if number == signal.SIGINT:
            os.write(terminal, b"\x03")
        else:
            os.kill(pid, number)
        while True:
            output += os.read(terminal, 4096)
    _, status = os.waitpid(pid, 0)
    os.close(terminal)
    words = output.decode()
    assert os.waitstatus_to_exitcode(status) == 128 + number, words
    assert "stopped by" in words
    assert "Traceback" not in words
