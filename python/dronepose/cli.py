"""The command ``dronepose-eval``: hands the arguments to Rust and returns its exit code.

Imports neither NumPy nor torch, so that the command starts in milliseconds.
"""

import signal
import sys
from collections.abc import Sequence

from dronepose import _native


def main(argv: Sequence[str] | None = None) -> int:
    """Run ``dronepose-eval``.

    Python's handler for Ctrl-C only runs between bytecodes, and the evaluation is one native call;
    the default action (end the process) is put back.

    Args:
        argv: The arguments without the program's name; ``sys.argv[1:]`` if absent.

    Returns:
        0 done, 1 an input was refused, 2 the command line was not understood.

    Example:
        >>> from dronepose.cli import main
        >>> main(["examples/predictions.csv", "examples/gt.csv", "--quiet"])
        0
    """
    signal.signal(signal.SIGINT, signal.SIG_DFL)
    arguments = sys.argv[1:] if argv is None else argv
    return _native.cli_run(["dronepose-eval", *arguments])


if __name__ == "__main__":
    sys.exit(main())
