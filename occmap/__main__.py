"""Run occmap, as the command that is installed or as `python -m occmap`."""

import signal


def main() -> None:
    """Import the command line and run it; Ctrl-C during the import ends the process silently."""
    if signal.getsignal(signal.SIGINT) is signal.default_int_handler:
        signal.signal(signal.SIGINT, signal.SIG_DFL)  # until the command line listens
    from occmap.cli import main as run_process  # noqa: PLC0415  late: after the line above

    run_process()


if __name__ == "__main__":
    main()
