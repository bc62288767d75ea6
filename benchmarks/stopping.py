"""Ctrl-C and SIGTERM at random moments of `pinwm control --arm`, through a pty, in every engine.

    python -m benchmarks.stopping --engine hydroelastic --moments 200

A process that has loaded everything forks one run after another, each with a terminal of its own (a pty); what a person
would type, or `kill`, comes at a random moment from 0 to `--within` s after its start. A run is good if it ends with
the signal's exit code, says how it was stopped, and shows no traceback; over LCM also if the last thing on the wire is
zero of no session. Prints a line for every run that is not, and a table, which `--out` keeps in a file; exits with 1
where there was one.
"""

import argparse
import collections
import contextlib
import multiprocessing
import os
import pty
import random
import select
import signal
import sys
import threading
import time
from collections.abc import Iterator
from multiprocessing.connection import Connection
from pathlib import Path

from benchmarks.results import write_json
from pinwm_drake.provenance import timestamp

SIGNALS = {"ctrl-c": signal.SIGINT, "sigterm": signal.SIGTERM, "hangup": signal.SIGHUP}
OPTIONS = {
    "twin": ["--engine", "twin"],
    "point": ["--engine", "point"],
    "hydroelastic": ["--engine", "hydroelastic"],
    "arm": ["--simulate-arm", "--contact", "point"],
    "lcm": ["--engine", "lcm"],
}
PATIENCE = 60.0  # s, for a process to end
LATE = 1.0  # s, for a command to be heard by this process
IMAGE_SIZE = 64  # px, of the bundle


def command(arguments: list[str]) -> int:
    """Exit code of `pinwm` with some arguments; 99 where an exception escapes, whose traceback is printed."""
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
    return code


def run(arguments: list[str], how: str, after: float) -> tuple[int, str, bool]:
    """Exit code and output of one run that is stopped `after` s, and whether it had not ended before."""
    pid, terminal = pty.fork()
    if pid == 0:
        code = 128 + signal.SIGINT  # where Ctrl-C comes before anything else
        try:
            code = command(arguments)
        finally:
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
        from drake import lcmt_drake_signal  # type: ignore[import-untyped]
        from pydrake.lcm import DrakeLcm

        self.last: list[float] = []
        self._lcm = DrakeLcm(url)

        def heard(message: bytes) -> None:
            self.last = list(lcmt_drake_signal.decode(message).val)

        self._lcm.Subscribe("PINWM_PUSHER_COMMAND", heard)
        threading.Thread(target=self._listen, daemon=True).start()

    def ends_with_zero(self) -> bool:
        """Whether the last command moves nothing and is of no session; waits for it, where the machine is busy."""
        end = time.monotonic() + LATE
        while any(self.last[:4]) and time.monotonic() < end:
            time.sleep(0.01)
        return not any(self.last[:4])

    def _listen(self) -> None:
        while True:
            self._lcm.HandleSubscriptions(5)


@contextlib.contextmanager
def arm_at(url: str) -> Iterator[tuple[Wire, Connection]]:
    """A simulated arm in a process of its own that takes seeds of places, and a listener to what it is sent."""
    from pinwm_drake.experiments.rehearsal.processes import run_arm
    from pinwm_drake.systems.envs.options import EnvOptions, environment_setup
    from pinwm_drake.systems.scenario.load import load_setup, with_url

    setup = with_url(environment_setup(load_setup("push_t"), EnvOptions(image_size=IMAGE_SIZE)), url)
    spawn = multiprocessing.get_context("spawn")
    pipe, other = spawn.Pipe()
    robot = spawn.Process(target=run_arm, args=(other, setup, 0.0), daemon=True)
    robot.start()
    other.close()
    try:
        yield Wire(url), pipe
    finally:
        robot.terminate()
        robot.join()


def moment(how: str, output: str) -> str:
    """When a run was stopped, by its own words; a closed terminal shows none."""
    if how == "hangup":
        return "at any moment"
    if not words(output):
        return "before it began"
    return "before it was armed" if "before it was armed" in output else "while armed"


def words(output: str) -> str:
    """Output without the terminal's own echo of Ctrl-C."""
    return output.replace("^C", "").strip()


def is_good(how: str, code: int, output: str, wire: Wire | None) -> bool:
    """Whether a run ended as it should: by its own exit code, or, before it began, by the signal itself."""
    number = int(SIGNALS[how])
    if how != "hangup" and words(output):
        ended = code == 128 + number and "stopped by" in output and "Traceback" not in output
    else:
        ended = code in (128 + number, -number)
    return ended and (wire is None or wire.ends_with_zero())


def campaign(
    options: argparse.Namespace, arguments: list[str], wire: Wire | None, arm: Connection | None
) -> dict[str, int]:
    """Counts of the runs of a campaign, by signal and moment; "bad" are those that did not end as they should."""
    within = options.within or 6.0
    generator, counts = random.Random(options.seed), collections.Counter({"bad": 0})
    ways = ["ctrl-c", "sigterm"] * 4 + ["hangup", "ctrl-c", "sigterm", "hangup"]
    for number in range(options.moments):
        how, sent = ways[number % len(ways)], False
        while not sent:  # what ended by itself is not counted
            # A terminal that closes before the new process has it is no terminal of its.
            after = generator.uniform(0.1 if how == "hangup" else 0.0, within)
            if wire is not None and arm is not None:
                arm.send(number)
                arm.recv()
                wire.last = []
            code, output, sent = run([*arguments, "--seed", str(number)], how, after)
            sent = sent and (code not in (0, 1) or "Traceback" in output)
        counts[f"{how}, {moment(how, output)}"] += 1
        if not is_good(how, code, output, wire):
            counts["bad"] += 1
            print(f"BAD {number}: {how} after {after:.3f} s: exit code {code}, wire {wire and wire.last}", flush=True)
            print("    " + output.strip().replace("\n", "\n    ")[-1500:], flush=True)
    return counts


def main() -> None:
    """Runs the campaign."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--engine", choices=OPTIONS, default="hydroelastic")
    parser.add_argument("--moments", type=int, default=200)
    parser.add_argument("--within", type=float, help="s; 6 unless told")
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--port", type=int, default=7667, help="of LCM")
    parser.add_argument("--out", type=Path, help="JSON file of the counts")
    options = parser.parse_args()
    arguments = ["control", "push_t", "--arm", *OPTIONS[options.engine]]
    with contextlib.ExitStack() as stack:
        wire, arm = None, None
        if options.engine == "lcm":
            url = f"udpm://239.255.76.67:{options.port}?ttl=0"
            arguments += ["--lcm-url", url]
            wire, arm = stack.enter_context(arm_at(url))
        # Everything is loaded once; only modules, so that what runs threads begins in each run.
        import pinwm_drake.cli.app
        import pinwm_drake.learning.bundle
        import pinwm_drake.systems.control.loop
        import pinwm_drake.systems.view.meshcat  # noqa: F401

        counts = campaign(options, arguments, wire, arm)
    for name, count in sorted(counts.items()):
        print(f"{count:5d}  {name}")
    about = {"engine": options.engine, "moments": options.moments, "seed": options.seed, "time": timestamp()}
    write_json(options.out, **about, counts=counts)
    sys.exit(counts["bad"] > 0)


if __name__ == "__main__":
    main()
