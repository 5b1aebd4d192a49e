"""A data set rendered on the Dask cluster that its user runs: see :class:`Cluster`."""

from __future__ import annotations

import json
import os
import platform
import threading
from dataclasses import dataclass, field
from functools import lru_cache, partial
from pathlib import Path
from typing import TYPE_CHECKING, Any

from dronepose.synth.dataset import SynthError, versions, write_row
from dronepose.synth.layout import record_file
from dronepose.synth.resuming import difference
from dronepose.synth.running import on_dask

if TYPE_CHECKING:
    from collections.abc import Callable, Generator, Mapping, Sequence

    from dronepose.camera import Camera
    from dronepose.synth.sample import RenderSettings
    from dronepose.synth.sources import Loaded, Sources

__all__ = ["Cluster"]


@dataclass(frozen=True, slots=True)
class Cluster:
    """A Dask cluster for :func:`dronepose.synth.write_dataset`, and what its workers read.

    The workers see the same files under the same absolute paths, and have the same versions of
    dronepose, NumPy and OpenCV; each process reads the inputs once and compares them with the
    manifest. The bits are those of a run without a cluster.

    Args:
        address: Of the scheduler, such as ``tcp://host:8786``, or its file (``.json``).
        sources: The files of the plan and the studio; the manifest's ``inputs`` have to be the
            ``facts`` of what :meth:`Sources.load` gives, but for licences.
        rows: Rows of the plan in a unit of work.
        say: Is told how many workers there are.

    Raises:
        ValueError: ``rows`` is below 1.

    Example:
        >>> sources = Sources("plan.csv", scene="house.glb")  # doctest: +SKIP
        >>> found, cluster = sources.load(), Cluster("tcp://head:8786", sources)  # doctest: +SKIP
        >>> made = write_dataset(  # doctest: +SKIP
        ...     "set", found.plan, found.studio, found.cameras, building="house",
        ...     environments=found.environments, inputs=found.facts, cluster=cluster,
        ... )  # fmt: skip
    """

    address: str
    sources: Sources
    rows: int = 4
    say: Callable[[str], None] = field(default=lambda text: None, repr=False)

    def __post_init__(self) -> None:
        if self.rows < 1:
            raise ValueError(f"rows: expected at least 1, got {self.rows}")

    def render(
        self,
        root: Path,
        facts: Mapping[str, Any],
        cameras: tuple[Camera, Camera],
        settings: RenderSettings,
        rows: Sequence[int],
    ) -> Generator[int, None, None]:
        """Render rows into a data set; gives the number of each unit's rows as it is done.

        Args:
            root: The data set.
            facts: Its manifest: ``building``, ``drone``, ``date``, ``inputs``.
            cameras: The exocentric and the egocentric camera.
            settings: Light and rules.
            rows: Which, of the plan.

        Raises:
            ImportError: The package ``distributed`` is missing.
            SynthError: A worker's inputs or versions are others.
            OSError: A file cannot be read or written, or the cluster is gone.

        Returns:
            The numbers.

        Example:
            >>> sum(cluster.render(root, facts, cameras, settings, [0, 1, 2]))  # doctest: +SKIP
            3
        """
        order = _Order(
            sources=self.sources.absolute(),
            root=os.path.abspath(root),  # noqa: PTH100 - keeps links
            place={name: facts[name] for name in ("building", "drone", "date")},
            cameras=cameras,
            settings=settings,
            inputs=json.dumps(facts["inputs"], sort_keys=True),
            versions=versions(),
        )
        units = (list(rows[k : k + self.rows]) for k in range(0, len(rows), self.rows))
        yield from on_dask(self.address, partial(render_unit, order), units, say=self.say)


@dataclass(frozen=True, slots=True)
class _Order:
    """What a worker has to know."""

    sources: Sources
    root: str
    place: dict[str, str]
    cameras: tuple[Camera, Camera]
    settings: RenderSettings
    inputs: str
    versions: dict[str, str]


_READING = threading.Lock()


def render_unit(order: _Order, rows: Sequence[int]) -> int:
    """Render some rows on a worker, but those that are there; their number.

    Raises:
        SynthError: The worker's inputs or versions are others.
        OSError: A file cannot be written.
    """
    root = Path(order.root)
    here = platform.node()
    try:
        for name, wanted in order.versions.items():
            found = versions()[name]
            if found != wanted and name != "python":
                raise SynthError(f"{name} {found}, expected {wanted} as where the command runs")
        with _READING:
            loaded = _loaded(order.sources, order.inputs)
    except (ImportError, OSError, ValueError) as error:
        raise SynthError(f"worker on {here}: {error}") from None
    for row in rows:
        # What a worker that died had done needs not be done again.
        if not record_file(root, order.place["building"], row).exists():
            write_row(
                root,
                order.place,
                loaded.studio,
                loaded.plan,
                row,
                order.cameras,
                loaded.environments,
                order.settings,
            )
    return len(rows)


@lru_cache(maxsize=1)
def _loaded(sources: Sources, inputs: str) -> Loaded:
    """The inputs, once a process, if they are those of the manifest."""
    loaded = sources.load(threads=1)
    differs = difference(json.loads(inputs), json.loads(json.dumps(loaded.facts)))
    if differs is not None:
        names, wanted, found = differs
        file = getattr(sources, names[0], None)
        if isinstance(file, tuple):
            file = file[int(names[1])] if len(names) > 1 else ", ".join(file)
        raise SynthError(
            f"{file}: is not what the command has read: {'.'.join(names)} is {found}, "
            f"expected {wanted}"
        )
    return loaded
