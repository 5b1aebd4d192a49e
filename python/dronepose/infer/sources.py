"""Frames from a picture, a folder of pictures, a video or a camera."""

from __future__ import annotations

import importlib.util
import re
from pathlib import Path
from typing import TYPE_CHECKING, Literal, NamedTuple

import cv2
import numpy as np

if TYPE_CHECKING:
    from collections.abc import Iterator

    from numpy.typing import NDArray

    Bytes = NDArray[np.uint8]

__all__ = ["Frame", "Source"]

PICTURES = frozenset({".bmp", ".jpeg", ".jpg", ".png", ".ppm", ".tif", ".tiff", ".webp"})
#: Of a folder or a camera that does not say its own.
DEFAULT_RATE = 30.0


class Frame(NamedTuple):
    """One frame.

    Attributes:
        id: Name of the file, or ``frame-000000`` and on.
        image: ``(H, W, 3)`` bytes, RGB.
    """

    id: str
    image: Bytes


class Source:
    """Where frames come from.

    Args:
        name: A picture, a folder of pictures (in the order of their names, numbers by value), a
            video, or the number of a camera such as ``"0"`` (if there is no such file).
        rate: Frames per second, instead of the video's or the usual 30.

    Attributes:
        kind: ``"image"``, ``"folder"``, ``"video"`` or ``"camera"``.
        rate: Frames per second.
        count: How many frames, if known beforehand.

    Raises:
        OSError: There is no such file, or no such camera.
        ValueError: It is neither a picture nor a video, or a folder without pictures.

    Example:
        >>> Source("examples/gt.csv")
        Traceback (most recent call last):
        ...
        ValueError: examples/gt.csv: neither a picture nor a video that can be read
    """

    def __init__(self, name: str, rate: float | None = None) -> None:
        self.name = name
        self.path = Path(name)
        self.kind: Literal["image", "folder", "video", "camera"]
        self.count: int | None = None
        found: float | None = None
        self._files: list[Path] = []
        if self.path.is_dir():
            self.kind = "folder"
            self._files = sorted(
                (p for p in self.path.iterdir() if _is_picture(p)), key=lambda p: _natural(p.name)
            )
            if not self._files:
                raise ValueError(f"{name}: expected pictures ({', '.join(sorted(PICTURES))})")
        elif not self.path.exists():
            if not re.fullmatch(r"\d{1,3}", name):
                raise FileNotFoundError(f"cannot read {name}: no such file")
            self.kind = "camera"
        elif _is_picture(self.path):
            self.kind, self._files = "image", [self.path]
        else:
            self.kind = "video"
            found, self.count = _probe(self.path)
        if self._files:
            self.count = len(self._files)
        self.rate = rate or found or DEFAULT_RATE

    @property
    def live(self) -> bool:
        """Whether the frames come but once.

        Example:
            >>> Source("docs/report.png").live
            False
        """
        return self.kind == "camera"

    def frames(self) -> Iterator[Frame]:
        """The frames from the first on; again from the first in each call.

        Yields:
            Frames, RGB.

        Raises:
            OSError: The camera does not answer.
            ValueError: A picture or the video is damaged.

        Example:
            >>> next(Source("docs/report.png").frames()).id
            'report'
        """
        if self.kind == "video":
            decoded = _decode_av(self.path) if _has_av() else _capture(str(self.path))
            yield from _numbered(decoded)
        elif self.kind == "camera":
            yield from _numbered(_capture(int(self.name)))
        else:
            stems = [file.stem for file in self._files]
            unique = len(set(stems)) == len(stems)
            for file in self._files:
                yield Frame(file.stem if unique else file.name, read_picture(file))


def read_picture(file: Path) -> Bytes:
    """A picture as ``(H, W, 3)`` bytes, RGB."""
    data = np.frombuffer(file.read_bytes(), dtype=np.uint8)
    image = cv2.imdecode(data, cv2.IMREAD_COLOR) if len(data) else None
    if image is None:
        raise ValueError(f"{file}: not a picture that can be read")
    return np.ascontiguousarray(image[:, :, ::-1], dtype=np.uint8)


def _numbered(images: Iterator[Bytes]) -> Iterator[Frame]:
    for number, image in enumerate(images):
        yield Frame(f"frame-{number:06d}", image)


def _is_picture(path: Path) -> bool:
    return path.suffix.lower() in PICTURES and path.is_file() and not path.name.startswith(".")


def _natural(name: str) -> list[tuple[int, str]]:
    """``frame2`` before ``frame10``."""
    parts = re.split(r"(\d+)", name)
    return [(int(part), "") if part.isdecimal() else (-1, part) for part in parts]


def _has_av() -> bool:
    return importlib.util.find_spec("av") is not None


def _probe(path: Path) -> tuple[float | None, int | None]:
    """Frames per second and how many, of a video with at least one frame."""
    wrong = ValueError(f"{path}: neither a picture nor a video that can be read")
    if _has_av():
        import av

        try:
            with av.open(str(path)) as file:
                stream = file.streams.video[0]
                next(file.decode(stream))
                rate = stream.average_rate or stream.guessed_rate
                return (float(rate) if rate else None), (stream.frames or None)
        except (av.FFmpegError, IndexError, StopIteration) as error:
            raise wrong from error
    capture = cv2.VideoCapture(str(path))
    try:
        if not capture.read()[0]:
            raise wrong
        shown, count = capture.get(cv2.CAP_PROP_FPS), int(capture.get(cv2.CAP_PROP_FRAME_COUNT))
        return (shown if shown > 0 else None), (count if count > 0 else None)
    finally:
        capture.release()


def _decode_av(path: Path) -> Iterator[Bytes]:
    import av

    number = 0
    try:
        with av.open(str(path)) as file:
            stream = file.streams.video[0]
            stream.thread_type = "AUTO"
            for number, frame in enumerate(file.decode(stream)):  # noqa: B007 - for the message
                yield np.asarray(frame.to_ndarray(format="rgb24"), dtype=np.uint8)
    except av.FFmpegError as error:
        raise ValueError(f"{path}: damaged after frame {number}: {error}") from error


def _capture(name: str | int) -> Iterator[Bytes]:
    # What goes wrong is said below, once.
    cv2.utils.logging.setLogLevel(cv2.utils.logging.LOG_LEVEL_ERROR)
    capture = cv2.VideoCapture(name)
    try:
        if not capture.isOpened():
            what = f"camera {name}" if isinstance(name, int) else name
            raise OSError(f"cannot read {what}: it does not answer")
        while True:
            there, image = capture.read()
            if not there:
                return
            yield np.ascontiguousarray(image[:, :, ::-1], dtype=np.uint8)
    finally:
        capture.release()
