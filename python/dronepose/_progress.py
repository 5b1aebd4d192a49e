"""What goes on, on standard error, for what takes longer than two seconds."""

from __future__ import annotations

import sys
import threading
import time
from typing import Any

__all__ = ["Progress", "Stages", "duration"]

_QUIET_S = 2.0


def duration(seconds: float) -> str:
    """A time in words.

    Args:
        seconds: How long.

    Example:
        >>> duration(42.3), duration(150), duration(7300)
        ('42 s', '2 min 30 s', '2 h 1 min')
    """
    whole = round(seconds)
    if whole < 60:
        return f"{whole} s"
    if whole < 3600:
        return f"{whole // 60} min {whole % 60} s"
    return f"{whole // 3600} h {whole % 3600 // 60} min"


class Progress:
    """How many are done, how many a second, and the time left.

    On a terminal it is one line that is written again, elsewhere a line now and then. What is done
    at the first call, by a run that was stopped, is not counted in the rate.

    Args:
        what: What is counted.
        stream: Where it is written; ``None`` is standard error.
        quiet: Say nothing.

    Example:
        >>> progress = Progress("rows")
        >>> progress(1, 100)
        >>> progress.close()
    """

    def __init__(self, what: str, stream: Any = None, *, quiet: bool = False) -> None:
        self._what, self._quiet = what, quiet
        self._stream = sys.stderr if stream is None else stream
        self._terminal = bool(self._stream.isatty())
        self._begin, self._said = time.monotonic(), float("-inf")
        self._before: int | None = None
        self._width = 0

    def __call__(self, done: int, total: int | None = None) -> None:
        """Say that ``done`` of ``total`` are there; ``None`` is a number that nobody knows."""
        now = time.monotonic()
        if self._before is None:
            self._begin, self._before = now, done
        gone = now - self._begin
        pause = 0.2 if self._terminal else 10.0
        if self._quiet or gone < _QUIET_S or (now - self._said < pause and done != total):
            return
        self._said, rate = now, (done - self._before) / gone
        of = "" if total is None else f"/{total}"
        text = f"{done}{of} {self._what}, {rate:.1f} a second"
        if total is not None and rate > 0:
            text += f", {duration((total - done) / rate)} left"
        if self._terminal:
            self._stream.write("\r" + text.ljust(self._width))
            self._width = len(text)
        else:
            self._stream.write(text + "\n")
        self._stream.flush()

    def close(self) -> None:
        """End the line, if there is one.

        Example:
            >>> Progress("rows").close()
        """
        if self._width:
            self._stream.write("\n")
            self._width = 0


class Stages:
    """Says what goes on, from two seconds after the beginning.

    Example:
        >>> with Stages() as stage:
        ...     stage("reading")
    """

    def __init__(self) -> None:
        self._begin = time.monotonic()
        self._text = "starting"
        self._lock = threading.Lock()
        # The work is native and lets other threads run.
        self._timer = threading.Timer(_QUIET_S, self._say)
        self._timer.daemon = True

    def __enter__(self) -> Stages:
        """Begin."""
        self._timer.start()
        return self

    def __exit__(self, *_: object) -> None:
        """End, said or not."""
        self._timer.cancel()

    def __call__(self, text: str) -> None:
        """Begin a stage."""
        with self._lock:
            self._text = text
        if time.monotonic() - self._begin >= _QUIET_S:
            self._say()

    def _say(self) -> None:
        with self._lock:
            gone = duration(time.monotonic() - self._begin)
            print(f"{gone}: {self._text}", file=sys.stderr, flush=True)
