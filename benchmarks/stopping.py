"""Ctrl-C and SIGTERM at random moments of `pinwm control --arm`, through a pty, in every engine.

    python -m benchmarks.stopping --engine hydroelastic --moments 200

A process that has loaded everything forks one run after another, each with a terminal of its own (a pty); what a person
would type, or `kill`, comes at a random moment from 0 to `--within` s after its start. A run is good if it ends with
the signal's exit code, says how it was stopped, and shows no traceback; over LCM also if the last thing on the wire is
zero of no session. Prints a line for every run that is not, and a table; exits with 1 where there was one.
"""

import argparse
import collections
import contextlib
import os
import pty
import random
import select
import signal
import subprocess
import sys
import threading
import time

SIGNALS = {"ctrl-c": signal.SIGINT, "sigterm": signal.SIGTERM, "hangup": signal.SIGHUP}
OPTIONS = {
    "twin": ["--engine", "twin"],
    "point": ["--engine", "point"],
    "hydroelastic": ["--engine", "hydroelastic"],
    "arm": ["--simulate-arm", "--contact", "point"],
    "lcm": ["--engine", "lcm"],
}
PATIENCE = 60.0  # s, for a process to end


def run(arguments: list[str], how: str, after: float) -> tuple[int, str, bool]:
    """Exit code and output of one run that is stopped `after` s, and whether it had not ended before."""
    pid, terminal = pty.fork()
    if pid == 0:
        signal.signal(signal.SIGINT, signal.default_int_handler)
        sys.argv = ["pinwm", *arguments]
        from pinwm_drake.cli import main

        code = 0
        try:
            main()
        except SystemExit as end:
            code = end.code if isinstance(end.code, int) else 1
        except BaseException:
            import traceback

            traceback.print_exc()
            code = 99
        with contextlib.suppress(OSError):
            sys.stdout.flush()
        os._exit(code)
    output, sent, began = b"", False, time.monotonic()
    while True:
        if not sent and time.monotonic() - began >= after:
            sent = True
            if how == "ctrl-c":
                os.write(terminal, b"\x03")
            elif how == "sigterm":
                os.kill(pid, signal.SIGTERM)
            else:
                os.close(terminal)
                break
        ready, _, _ = select.select([terminal], [], [], 0.005)
        if ready:
            try:
                piece = os.read(terminal, 4096)
            except OSError:
                break  # it has ended
            if not piece:
                break
            output += piece
        if time.monotonic() - began > after + PATIENCE:
            os.kill(pid, signal.SIGKILL)
            output += b"\nIT DID NOT END"
            break
    _, status = os.waitpid(pid, 0)
    if how != "hangup":
        os.close(terminal)
    return os.waitstatus_to_exitcode(status), output.decode(errors="replace"), sent


class Wire:
    """Listener to the commands that go to a robot over LCM, in a thread."""

    def __init__(self, url: str) -> None:
        """Listens at an address."""
        from drake import lcmt_drake_signal  # type: ignore[import-untyped]
        from pydrake.lcm import DrakeLcm

        self.last: list[float] = []
        self._lcm = DrakeLcm(url)

        def heard(message: bytes) -> None:
            self.last = list(lcmt_drake_signal.decode(message).val)

        self._lcm.Subscribe("PINWM_PUSHER_COMMAND", heard)
        threading.Thread(target=self._listen, daemon=True).start()

    def _listen(self) -> None:
        while True:
            self._lcm.HandleSubscriptions(5)


def main() -> None:
    """Runs the campaign."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--engine", choices=OPTIONS, default="hydroelastic")
    parser.add_argument("--moments", type=int, default=200)
    parser.add_argument("--within", type=float, help="s; 4 for the twin, which is fast, and otherwise 6")
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--port", type=int, default=7667, help="of LCM")
    options = parser.parse_args()
    arguments = ["control", "push_t", "--arm", *OPTIONS[options.engine]]
    robot, wire = None, None
    if options.engine == "lcm":
        url = f"udpm://239.255.76.67:{options.port}?ttl=0"
        arguments += ["--lcm-url", url]
        code = "from pinwm_drake.cli import main; main()"
        robot = subprocess.Popen(
            [sys.executable, "-c", code, "arm", "--duration", "3600", "--lcm-url", url], stdout=subprocess.DEVNULL
        )
        wire = Wire(url)
        time.sleep(15.0)
    # Everything is loaded once; only modules, so that what runs threads begins in each run.
    import pinwm_drake.cli.app
    import pinwm_drake.learning.bundle
    import pinwm_drake.systems.control.loop
    import pinwm_drake.systems.view.meshcat  # noqa: F401

    within = options.within or (4.0 if options.engine == "twin" else 6.0)
    generator, ends, bad = random.Random(options.seed), collections.Counter(), 0
    for number in range(options.moments):
        how = ("ctrl-c", "sigterm", "hangup")[number % 3 if number % 10 == 2 else number % 2]
        sent = False
        while not sent:
            after = generator.uniform(0.0, within)
            if wire is not None:
                wire.last = []
            code, output, sent = run([*arguments, "--seed", str(number)], how, after)
            time.sleep(0.05)
            ends["not counted: it had ended by itself"] += not sent
        before = "before it was armed" in output or (how == "hangup" and wire is None)
        good = code == 128 + SIGNALS[how] and "Traceback" not in output
        good = good and (how == "hangup" or "stopped by" in output or not output)
        if wire is not None and wire.last:
            good = good and not any(wire.last[:4])
        ends[f"{how}: {'before it was armed' if before else 'armed'}"] += 1
        if not good:
            bad += 1
            print(f"BAD {number}: {how} after {after:.3f} s: exit code {code}, wire {wire and wire.last}", flush=True)
            print("    " + output.strip().replace("\n", "\n    ")[-1500:], flush=True)
    if robot is not None:
        robot.terminate()
        robot.wait()
    for name, count in sorted(ends.items()):
        print(f"{count:5d}  {name}")
    print(f"{options.engine}: {options.moments - bad} of {options.moments} good")
    sys.exit(bad > 0)


if __name__ == "__main__":
    main()
