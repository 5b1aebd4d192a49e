"""What the subcommands share: how one is run, and how it ends."""

from __future__ import annotations

import sys
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    import argparse
    from collections.abc import Callable, Sequence

GOES_ON = "stopped; the same command goes on"


def run(
    parser: argparse.ArgumentParser,
    argv: Sequence[str] | None,
    work: Callable[[argparse.Namespace], int],
    *,
    stopped: str = "stopped; nothing was written",
    also: tuple[type[Exception], ...] = (),
) -> int:
    """Run a subcommand.

    Args:
        parser: Its options; a default ``stopped`` of a parser wins over the argument here.
        argv: Its arguments; ``None`` is ``sys.argv[1:]``.
        work: Does what they ask for; its exit code.
        stopped: What Ctrl-C has left, in words.
        also: Errors that are a refused input, beside ImportError, OSError and ValueError.

    Returns:
        That of ``work``, 1 an input was refused, 2 the command line was not understood, 130
        interrupted.
    """
    try:
        args = parser.parse_args(None if argv is None else list(argv))
    except SystemExit as end:
        return int(end.code or 0)
    refused: tuple[type[Exception], ...] = (ImportError, OSError, ValueError, *also)
    try:
        return work(args)
    except refused as error:
        print(f"error: {error}", file=sys.stderr)
        return 1
    except KeyboardInterrupt:
        print(getattr(args, "stopped", stopped), file=sys.stderr)
        return 130
