"""What is wrong with a data set, and where."""

from __future__ import annotations

from typing import TYPE_CHECKING, NoReturn

if TYPE_CHECKING:
    from pathlib import Path


class DataError(ValueError):
    """A file of a data set is broken or says something impossible.

    The message starts with the file, and the line and column where there is one, and names the
    sample.

    Example:
        >>> raise DataError("train/poses.csv:7: sample 'train-000005': t is not finite")
        Traceback (most recent call last):
        ...
        dronepose.data._errors.DataError: train/poses.csv:7: sample 'train-000005': t is not finite
    """


def read_text(path: Path, what: str) -> str:
    """All of a UTF-8 file, ends of lines as they are, without a byte order mark.

    Args:
        path: The file.
        what: What it is to be, for the message.

    Raises:
        FileNotFoundError: There is no such file.
        DataError: It is not UTF-8.
    """
    if not path.is_file():
        missing(path, what)
    try:
        return path.read_bytes().decode("utf-8-sig")
    except UnicodeDecodeError as error:
        raise DataError(f"{path}: not UTF-8 at byte {error.start}, expected {what}") from None


def missing(path: Path, what: str) -> NoReturn:
    """Raise :class:`FileNotFoundError` that says what the file was to be."""
    raise FileNotFoundError(f"{path}: no such file, expected {what}")
