"""`python -m bcid`, and the program `bcid`."""

import os
import sys


def start() -> None:
    """Run the command line and end the process; Ctrl-C ends it by one line even while modules are being imported."""
    try:
        from bcid.cli.app import main
        from bcid.cli.exits import INTERRUPTED
    except KeyboardInterrupt:
        sys.stderr.write("interrupted before anything was done\n")
        _exit_at_once(130)
    try:
        main()
    except SystemExit as ended:
        if ended.code == INTERRUPTED:
            _exit_at_once(INTERRUPTED)
        raise


def _exit_at_once(code: int) -> None:
    """End the process with this exit code, where Python might end it by the signal that interrupted an import."""
    sys.stderr.flush()
    os._exit(code)


if __name__ == "__main__":
    start()
