"""Files and folders that are written whole or not at all.

What is written goes to a hidden file in the same folder, which then takes the name that was asked
for: a reader, and the next run after a kill, sees the file before or the file after. The hidden
name says which process writes it, so that :func:`sweep` can tell what a kill has left.
"""

from __future__ import annotations

import itertools
import os
import platform
import re
import secrets
import shutil
import time
from contextlib import contextmanager
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from collections.abc import Callable, Iterator
    from pathlib import Path

__all__ = ["beside", "folder_beside", "sweep", "write_bytes", "write_text"]

_RUN = secrets.token_hex(4)  # a process may have the number of one that is gone
_COUNT = itertools.count()
_HOST = re.sub(r"[^0-9A-Za-z-]+", "-", platform.node())[:32] or "-"
_PART = re.compile(
    r"\.(?P<stem>.+)\.(?P<host>[0-9A-Za-z-]+)\.(?P<process>\d+)\.(?P<run>[0-9a-f]{8})-\d+\.part"
    r"(\.[^.]*)?"
)
_LONG_S = 3600.0
"""After so long nobody is still writing a file, on whatever machine."""


@contextmanager
def beside(target: Path) -> Iterator[Path]:
    """A name beside a file to write to; takes the file's place if all went well, or vanishes.

    Args:
        target: The file; its folder exists.

    Yields:
        A hidden name with the suffix of ``target``, of this call alone.

    Raises:
        OSError: Nothing was written, or it cannot take the place of ``target``.

    Example:
        >>> import tempfile
        >>> from pathlib import Path
        >>> with tempfile.TemporaryDirectory() as folder:
        ...     with beside(Path(folder) / "a.txt") as part:
        ...         _ = part.write_text("all of it")
        ...     [path.name for path in Path(folder).iterdir()]
        ['a.txt']
    """
    part = _part(target)
    try:
        yield part
        part.replace(target)
    finally:
        part.unlink(missing_ok=True)


@contextmanager
def folder_beside(target: Path) -> Iterator[Path]:
    """A folder to write to beside one that is to be: as :func:`beside`, and leftovers are swept.

    Args:
        target: The folder; not there, or empty. The folder above is made.

    Yields:
        A folder with a hidden name.

    Raises:
        OSError: It cannot be made, or cannot take the place of ``target``.

    Example:
        >>> import tempfile
        >>> from pathlib import Path
        >>> with tempfile.TemporaryDirectory() as above:
        ...     with folder_beside(Path(above) / "set") as part:
        ...         _ = (part / "a.txt").write_text("all of it")
        ...     [path.name for path in Path(above).rglob("*")]
        ['set', 'a.txt']
    """
    target.parent.mkdir(parents=True, exist_ok=True)
    sweep(target.parent)
    part = _part(target)
    part.mkdir()
    try:
        yield part
        part.replace(target)
    finally:
        shutil.rmtree(part, ignore_errors=True)


def _part(target: Path) -> Path:
    """A hidden name beside ``target``, of this call alone."""
    writer = f"{_HOST}.{os.getpid()}.{_RUN}-{next(_COUNT)}"
    return target.with_name(f".{target.stem}.{writer}.part{target.suffix}")


def sweep(folder: Path, also: Callable[[str], bool] | None = None) -> int:
    """Remove what killed processes have left in a folder that :func:`beside` writes to.

    Left are hidden files and folders of a process of this machine that is gone, and of any machine
    if nothing in them is younger than an hour. Other folders below are not looked at.

    Args:
        folder: The folder; nothing is done if it is not there.
        also: Is asked with the stem of the file that was to be written; what it affirms is removed
            whoever wrote it.

    Returns:
        How many were removed.

    Raises:
        OSError: One cannot be removed.
    """
    count = 0
    try:
        entries = os.scandir(folder)
    except (FileNotFoundError, NotADirectoryError):
        return 0
    with entries:
        for entry in entries:
            match = _PART.fullmatch(entry.name)
            if match is None:
                continue
            try:
                if (also is not None and also(match["stem"])) or _is_left(entry, match):
                    if entry.is_dir(follow_symlinks=False):
                        shutil.rmtree(entry.path)
                    else:
                        os.unlink(entry.path)  # noqa: PTH108 - an entry is no Path
                    count += 1
            except FileNotFoundError:
                continue  # it has taken its place, or another run sweeps too
    return count


def _is_left(entry: os.DirEntry[str], match: re.Match[str]) -> bool:
    if match["host"] == _HOST and not _writes(int(match["process"]), match["run"]):
        return True
    return time.time() - _changed(entry) > _LONG_S


def _changed(entry: os.DirEntry[str]) -> float:
    """When a file, or the last of all that is in a folder, was written."""
    times = [entry.stat(follow_symlinks=False).st_mtime]
    if entry.is_dir(follow_symlinks=False):
        with os.scandir(entry.path) as entries:
            times += map(_changed, entries)
    return max(times)


def _writes(process: int, run: str) -> bool:
    """Whether a process of this machine is there that may be writing."""
    if process == os.getpid():
        return run == _RUN
    try:
        os.kill(process, 0)
    except (ProcessLookupError, OverflowError):
        return False
    except OSError:
        return True  # of somebody else
    return True


def write_bytes(path: Path, content: bytes) -> None:
    """Write a file whole or not at all; its folder is made if it is not there.

    Args:
        path: The file.
        content: All of it.

    Raises:
        OSError: The file cannot be written.
    """
    path.parent.mkdir(parents=True, exist_ok=True)
    with beside(path) as part:
        part.write_bytes(content)


def write_text(path: Path, text: str) -> None:
    """Write a UTF-8 file whole or not at all, ends of lines as they are.

    Args:
        path: The file; its folder is made if it is not there.
        text: All of it.

    Raises:
        OSError: The file cannot be written.
    """
    write_bytes(path, text.encode())
