"""Videos written frame by frame: PyAV if it is installed, OpenCV otherwise."""

from __future__ import annotations

import importlib.util
from contextlib import contextmanager
from fractions import Fraction
from typing import TYPE_CHECKING, Any

import cv2
import numpy as np

from dronepose._files import beside

if TYPE_CHECKING:
    from collections.abc import Callable, Iterator
    from pathlib import Path

    from numpy.typing import NDArray

    Bytes = NDArray[np.uint8]

__all__ = ["video_writer"]


@contextmanager
def video_writer(target: Path, rate: float) -> Iterator[Callable[[Bytes], None]]:
    """A function that adds a frame to a video; the file appears when all are written.

    Args:
        target: The file, ``.mp4``.
        rate: Frames per second.

    Yields:
        A function of ``(H, W, 3)`` bytes, RGB; all frames have the size of the first. An odd last
        row or column is repeated, because the codec wants even sizes.

    Raises:
        OSError: The file cannot be written.
        ValueError: A frame has another size than the first.
    """
    state: dict[str, Any] = {}
    use_av = importlib.util.find_spec("av") is not None
    with beside(target) as part:

        def add(frame: Bytes) -> None:
            if state.setdefault("size", frame.shape) != frame.shape:
                raise ValueError(
                    f"{target}: expected frames of {state['size'][1]}x{state['size'][0]}, "
                    f"got {frame.shape[1]}x{frame.shape[0]}"
                )
            odd = [(0, n % 2) for n in frame.shape[:2]]
            even = np.ascontiguousarray(np.pad(frame, [*odd, (0, 0)], mode="edge"))
            if "write" not in state:
                opened = (_av if use_av else _cv)(part, rate, even.shape[1], even.shape[0])
                state["write"], state["close"] = opened
            state["write"](even)

        try:
            yield add
        except BaseException:
            close = state.pop("close", None)
            if close is not None:
                close()
            raise
        if "close" not in state:
            raise ValueError(f"{target}: no frame to write")
        state["close"]()


def _av(
    part: Path, rate: float, width: int, height: int
) -> tuple[Callable[[Bytes], None], Callable[[], None]]:
    import av

    file = av.open(str(part), "w")
    whole = Fraction(rate).limit_denominator(1001)
    try:
        stream = file.add_stream("libx264", rate=whole, options={"crf": "18", "preset": "veryfast"})
    except (av.FFmpegError, ValueError):  # a build without it
        stream = file.add_stream("mpeg4", rate=whole)
    stream.width, stream.height, stream.pix_fmt = width, height, "yuv420p"

    def write(frame: Bytes) -> None:
        file.mux(stream.encode(av.VideoFrame.from_ndarray(frame, format="rgb24")))

    def close() -> None:
        file.mux(stream.encode())
        file.close()

    return write, close


def _cv(
    part: Path, rate: float, width: int, height: int
) -> tuple[Callable[[Bytes], None], Callable[[], None]]:
    codec = cv2.VideoWriter.fourcc(*"mp4v")
    writer = cv2.VideoWriter(str(part), codec, rate, (width, height))
    if not writer.isOpened():
        raise OSError(f"cannot write {part}: no codec mp4v")

    def write(frame: Bytes) -> None:
        writer.write(np.ascontiguousarray(frame[:, :, ::-1]))

    return write, writer.release
