"""Frames in; poses, pictures and a video out: what ``dronepose infer`` does."""

from __future__ import annotations

import time
from contextlib import ExitStack
from dataclasses import dataclass, field
from itertools import islice
from typing import TYPE_CHECKING, Any, Literal

import numpy as np

from dronepose._files import write_text
from dronepose.data._images import write_png
from dronepose.data._poses import poses_csv
from dronepose.infer.filters import OneEuro, Track, jitter, rts
from dronepose.infer.frames import Fit
from dronepose.infer.overlay import Style, draw
from dronepose.infer.video import video_writer

if TYPE_CHECKING:
    from collections.abc import Callable, Iterator
    from pathlib import Path

    from numpy.typing import NDArray

    from dronepose.camera import Camera
    from dronepose.infer.predictor import Predictor
    from dronepose.infer.sources import Frame, Source
    from dronepose.mesh import Mesh

    Bytes = NDArray[np.uint8]
    Array = NDArray[np.float64]
    Pose = tuple[Array, Array]

__all__ = ["Options", "infer"]

SCHEMA = "dronepose-infer/1"


@dataclass(frozen=True, slots=True, kw_only=True)
class Options:
    """How :func:`infer` works.

    Attributes:
        camera: The camera of the frames, if it is not that of the weights.
        letterbox: Whether frames of another aspect ratio get bars, or are refused.
        mesh: Drawn where the drone is.
        style: Parts and colours of the drawing.
        overlay: Whether frames are drawn at all.
        filter: ``"none"``, ``"one-euro"`` (past frames only) or ``"rts"`` (recordings only).
        min_cutoff: Cut-off of one-euro at rest, hertz.
        beta: Growth of that with the speed.
        batch: Frames predicted together; 1 for a camera.
        limit: Stop after so many frames.
    """

    camera: Camera | None = None
    letterbox: bool = True
    mesh: Mesh | None = None
    style: Style = field(default_factory=Style)
    overlay: bool = True
    filter: Literal["none", "one-euro", "rts"] = "none"
    min_cutoff: float = 1.0
    beta: float = 2.0
    batch: int = 8
    limit: int | None = None


class _Lane:
    """One network on the way through the frames."""

    def __init__(self, predictor: Predictor, options: Options, rate: float) -> None:
        self.predictor, self.options = predictor, options
        self.fits: dict[tuple[int, int], Fit] = {}
        self.raw: list[Pose] = []
        self.smooth: list[Pose] = []
        self.seconds = 0.0
        self.filter = (
            OneEuro(rate, options.min_cutoff, options.beta)
            if options.filter == "one-euro"
            else None
        )

    def fit(self, frame: Bytes) -> Fit:
        size = frame.shape[0], frame.shape[1]
        if size not in self.fits:
            self.fits[size] = Fit.plan(
                size,
                self.predictor.image_size,
                intrinsics=self.predictor.metadata.get("intrinsics"),
                camera=self.options.camera,
                aware=self.predictor.aware,
                letterbox=self.options.letterbox,
            )
        return self.fits[size]

    def predict(self, frames: list[Frame]) -> None:
        """Poses of some more frames, filtered if that needs no later ones."""
        fits = [self.fit(frame.image) for frame in frames]
        images = np.stack([f.image(frame.image) for f, frame in zip(fits, frames, strict=True)])
        K = np.stack([f.network.K for f in fits])
        start = time.perf_counter()
        R, t = self.predictor(images, K)
        self.seconds += time.perf_counter() - start
        for pose in zip(R, t, strict=True):
            self.raw.append(pose)
            if self.options.filter != "rts":
                self.smooth.append(pose if self.filter is None else self.filter(*pose))

    def finish(self, rate: float) -> None:
        """The filter that needs all frames."""
        if self.options.filter == "rts":
            track = rts(*_track(self.raw), rate)
            self.smooth = list(zip(*track, strict=True))


def infer(
    source: Source,
    predictors: list[Predictor],
    out: Path,
    options: Options,
    progress: Callable[[int, float], None] = lambda done, seconds: None,
) -> dict[str, Any]:
    """Predict, filter, draw and write.

    ``out`` gets ``poses.csv`` (and ``poses_2.csv`` of a second network; with a filter
    ``poses_raw.csv`` too), ``overlay.mp4`` for videos and cameras, ``overlays/ID.png`` for
    pictures. Each file appears when it is complete. Ctrl-C ends a camera's recording in good order
    and everything else without the files that were not complete.

    Args:
        source: The frames.
        predictors: One network, or two to compare side by side.
        out: A folder; made if it is not there.
        options: The rest.
        progress: Called with the frames done and the seconds gone.

    Returns:
        What was done, as for JSON.

    Raises:
        OSError: A file cannot be read or written.
        ValueError: A frame is damaged or does not fit, or the filter does not fit the source.
    """
    if options.filter != "none" and source.kind == "image":
        raise ValueError("--filter: one picture does not move")
    if options.filter == "rts" and source.live:
        raise ValueError("--filter rts: needs a recording; a camera can use one-euro")
    out.mkdir(parents=True, exist_ok=True)
    lanes = [_Lane(predictor, options, source.rate) for predictor in predictors]
    start = time.perf_counter()
    ids: list[str] = []
    files: list[str] = []
    if options.filter == "rts":
        for chunk in _chunks(source, options):
            for lane in lanes:
                lane.predict(chunk)
            ids += [frame.id for frame in chunk]
            progress(len(ids), time.perf_counter() - start)
        for lane in lanes:
            lane.finish(source.rate)
    if options.filter != "rts" or options.overlay:
        predicted = bool(ids)
        drawn = 0
        with ExitStack() as stack:
            show = _output(source, out, stack, files) if options.overlay else None
            try:
                for chunk in _chunks(source, options):
                    if not predicted:
                        for lane in lanes:
                            lane.predict(chunk)
                        ids += [frame.id for frame in chunk]
                    for frame in chunk:
                        if show is not None:
                            show(frame, _drawn(frame, lanes, drawn, options))
                        drawn += 1
                    progress(drawn, time.perf_counter() - start)
            except KeyboardInterrupt:
                if not source.live or not drawn:
                    raise
                ids = ids[:drawn]
    if not ids:
        raise ValueError(f"{source.name}: holds no frames")
    seconds = time.perf_counter() - start
    models = [
        _finished(lane, k, ids, source, out, options, files) for k, lane in enumerate(lanes, 1)
    ]
    return {
        "schema": SCHEMA,
        "input": source.name,
        "kind": source.kind,
        "frames": len(ids),
        "rate": source.rate,
        "seconds": seconds,
        "frames_per_second": len(ids) / seconds,
        "filter": options.filter,
        "models": models,
        "files": files,
    }


def _finished(
    lane: _Lane, number: int, ids: list[str], source: Source, out: Path, options: Options,
    files: list[str],
) -> dict[str, Any]:  # fmt: skip
    """Write the poses of a network and sum it up."""
    raw, smooth = lane.raw[: len(ids)], lane.smooth[: len(ids)]
    ending = "" if number == 1 else f"_{number}"
    rate = None if source.kind in ("image", "folder") else source.rate
    named = [(out / f"poses{ending}.csv", smooth)]
    if options.filter != "none":
        named.append((out / f"poses_raw{ending}.csv", raw))
    for path, poses in named:
        write_text(path, _csv(ids, poses, rate))
        files.append(str(path))
    notes = sorted({fit.note for fit in lane.fits.values() if fit.note})
    summary: dict[str, Any] = {
        "weights": str(lane.predictor.path),
        "network_ms": 1000.0 * lane.seconds / len(lane.raw),
        "notes": notes,
    }
    if source.kind != "image":
        for key, poses in (("jitter", smooth), ("jitter_raw", raw)):
            metres, degrees = jitter(*_track(poses))
            summary[key] = {"position_m": metres, "rotation_deg": degrees}
    return summary


def _chunks(source: Source, options: Options) -> Iterator[list[Frame]]:
    frames = islice(source.frames(), options.limit)
    size = 1 if source.live else options.batch
    while chunk := list(islice(frames, size)):
        yield chunk


def _output(
    source: Source, out: Path, stack: ExitStack, files: list[str]
) -> Callable[[Frame, Bytes], None]:
    """Where drawn frames go."""
    if source.kind in ("video", "camera"):
        path = out / "overlay.mp4"
        add = stack.enter_context(video_writer(path, source.rate))
        files.append(str(path))
        return lambda frame, image: add(image)
    folder = out / "overlays"
    folder.mkdir(exist_ok=True)
    files.append(str(folder))

    def save(frame: Frame, image: Bytes) -> None:
        write_png(folder / f"{frame.id}.png", image)

    return save


def _drawn(frame: Frame, lanes: list[_Lane], index: int, options: Options) -> Bytes:
    """The frame with the pose of each network, side by side."""
    halves = []
    for lane in lanes:
        R, t = lane.smooth[index]
        label = lane.predictor.path.stem if len(lanes) > 1 else ""
        camera = lane.fit(frame.image).frame
        halves.append(
            draw(frame.image, camera, R, t, mesh=options.mesh, style=options.style, label=label)
        )
    return np.concatenate(halves, axis=1)


def _csv(ids: list[str], poses: list[Pose], rate: float | None) -> str:
    """The format of predictions, docs/formats.md; with the time in seconds for videos."""
    R, t = _track(poses)
    times = {"time_s": [f"{k / rate:.6f}" for k in range(len(ids))]} if rate else None
    return poses_csv(ids, _orthonormal(R), t, form=".9f", further=times)


def _orthonormal(R: Array) -> Array:
    """The nearest rotations, so that float32 of the network is not reported as departing."""
    U, _, Vt = np.linalg.svd(R)
    found: Array = U @ Vt
    return found


def _track(poses: list[Pose]) -> Track:
    return Track(np.stack([R for R, _ in poses]), np.stack([t for _, t in poses]))
