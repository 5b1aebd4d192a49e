"""Files that are written whole or not at all.

What is written goes to a hidden file in the same folder, which then takes the name that was asked
for: a reader, and the next run after a kill, sees the file before or the file after.
"""

from __future__ import annotations

import os
from contextlib import contextmanager
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from collections.abc import Iterator
    from pathlib import Path

__all__ = ["beside", "write_bytes", "write_text"]


@contextmanager
def beside(target: Path) -> Iterator[Path]:
    """A name beside a file to write to; takes the file's place if all went well, or vanishes.

    Args:
        target: The file; its folder exists.

    Yields:
        A hidden name with the suffix of ``target``, of this process alone.

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
    part = target.with_name(f".{target.stem}.{os.getpid()}.part{target.suffix}")
    try:
        yield part
        part.replace(target)
    finally:
        part.unlink(missing_ok=True)


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
