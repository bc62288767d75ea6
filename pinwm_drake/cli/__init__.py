"""The command line `pinwm`. It may import everything, and nothing imports it."""


def main() -> None:
    """Runs `pinwm` on the command line and ends the process with its exit code; Ctrl-C while it is loaded, with 130."""
    try:
        from pinwm_drake.cli.app import main as run
    except KeyboardInterrupt:
        raise SystemExit(130) from None
    run()
