# SPDX-License-Identifier: MIT
"""The command line `pinwm`. It may import everything, and nothing imports it."""


def main() -> None:
    """Run `pinwm` on the command line and end the process with its exit code; 130 at Ctrl-C before a command."""
    try:
        from pinwm_drake.cli.app import main as run

        run()
    except KeyboardInterrupt:
        raise SystemExit(130) from None
