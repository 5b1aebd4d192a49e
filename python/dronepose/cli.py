"""The commands ``dronepose`` and ``dronepose-eval``: hand the arguments to Rust.

Imports neither NumPy nor torch, so that the commands start in milliseconds.

``dronepose render`` and ``dronepose eval`` are Rust. A module ``dronepose.commands.NAME`` with a
function ``main(argv) -> int`` is the subcommand ``dronepose NAME``; the first line of its docstring
is its line of the help. It is imported only when it is called.
"""

import ast
import os
import signal
import sys
from collections.abc import Sequence
from functools import cache
from importlib import import_module
from pathlib import Path

from dronepose import _native


def main(argv: Sequence[str] | None = None) -> int:
    """Run ``dronepose-eval``.

    Python's handler for Ctrl-C only runs between bytecodes, and the evaluation is one native call:
    from here on Ctrl-C, a hang-up and a request to terminate end the process, without unfinished
    files.

    Args:
        argv: The arguments without the program's name; ``sys.argv[1:]`` if absent.

    Returns:
        0 done, 1 an input was refused, 2 the command line was not understood.

    Example:
        >>> from dronepose.cli import main
        >>> main(["examples/predictions.csv", "examples/gt.csv", "--quiet"])
        0
    """
    _leave_signals_to_rust()
    arguments = sys.argv[1:] if argv is None else argv
    return _native.cli_run(["dronepose-eval", *arguments])


def dronepose(argv: Sequence[str] | None = None) -> int:
    """Run ``dronepose``: ``render``, ``eval``, or a subcommand written in Python.

    Args:
        argv: The arguments without the program's name; ``sys.argv[1:]`` if absent.

    Returns:
        0 done, 1 an input was refused, 2 the command line was not understood.

    Example:
        >>> from dronepose.cli import dronepose
        >>> dronepose(["eval", "examples/predictions.csv", "examples/gt.csv", "--quiet"])
        0
    """
    arguments = list(sys.argv[1:] if argv is None else argv)
    modules = _modules()
    if arguments and arguments[0] in modules:
        module = import_module(f"dronepose.commands.{modules[arguments[0]].stem}")
        code: int = module.main(arguments[1:])
        return code
    _leave_signals_to_rust()
    # Only the help and the message on an unknown subcommand need to know of the others.
    listed = not arguments or arguments[0] not in ("render", "eval")
    further = [(name, _summary(path)) for name, path in modules.items()] if listed else []
    return _native.cli_dronepose(["dronepose", *arguments], further)


def _leave_signals_to_rust() -> None:
    signal.signal(signal.SIGINT, signal.SIG_DFL)
    _give_signals_back_to_children()


@cache  # once
def _give_signals_back_to_children() -> None:
    """A forked child inherits the handlers but not the thread that acts on them.

    Without this it could not be terminated: a ``multiprocessing.Pool`` would wait for it forever.
    """

    def give_back() -> None:
        for name in ("SIGINT", "SIGTERM", "SIGHUP"):
            number = getattr(signal, name, None)
            handler = None if number is None else signal.getsignal(number)
            if number is not None and handler is not None:
                signal.signal(number, handler)

    if hasattr(os, "register_at_fork"):
        os.register_at_fork(after_in_child=give_back)


def _modules() -> dict[str, Path]:
    """The subcommands written in Python, by name."""
    folder = Path(__file__).with_name("commands")
    files = sorted(folder.glob("[a-z]*.py"))
    return {path.stem.replace("_", "-"): path for path in files}


def _summary(path: Path) -> str:
    """First line of a module's docstring, without importing it."""
    docstring = ast.get_docstring(ast.parse(path.read_text(encoding="utf-8"))) or ""
    return docstring.partition("\n")[0].rstrip(".")


if __name__ == "__main__":
    sys.exit(main())
