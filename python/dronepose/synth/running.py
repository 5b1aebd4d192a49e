"""Work on many items: by threads here, or by the workers of a Dask cluster that runs already."""

from __future__ import annotations

from concurrent.futures import FIRST_COMPLETED, CancelledError, ThreadPoolExecutor, wait
from importlib.util import find_spec
from itertools import islice
from typing import TYPE_CHECKING, Any, TypeVar

if TYPE_CHECKING:
    from collections.abc import Callable, Generator, Iterable

    Item = TypeVar("Item")
    Result = TypeVar("Result")

__all__ = ["by_threads", "on_dask"]

IN_FLIGHT = 512
"""Units that are with the cluster at a time: many, for clusters that grow with their work."""


def by_threads(
    work: Callable[[Item], Result], items: Iterable[Item], workers: int
) -> Generator[Result, None, None]:
    """The results of ``work`` for every item, as they come; the first error ends it.

    At an error, and when the caller stops, what has begun is finished and nothing else begun. What
    is asked for ahead is bounded, whatever the number of items.

    Args:
        work: Called with an item.
        items: What is worked on.
        workers: Number of threads; with 1 it is done by the caller's.

    Raises:
        Exception: What ``work`` raises.

    Example:
        >>> sorted(by_threads(abs, [1, -2, 3], 2))
        [1, 2, 3]
    """
    waiting = iter(items)
    if workers <= 1:
        yield from map(work, waiting)
        return
    pool = ThreadPoolExecutor(workers)
    try:
        running = {pool.submit(work, item) for item in islice(waiting, 2 * workers)}
        while running:
            done, running = wait(running, return_when=FIRST_COMPLETED)
            while done:
                yield done.pop().result()
                running |= {pool.submit(work, item) for item in islice(waiting, 1)}
    finally:
        pool.shutdown(cancel_futures=True)


def on_dask(
    address: str,
    work: Callable[[Item], Result],
    items: Iterable[Item],
    *,
    say: Callable[[str], None] = lambda text: None,
) -> Generator[Result, None, None]:
    """The results of ``work`` for every item, as the workers of a Dask cluster have them.

    An item whose worker dies goes to another worker; ``work`` has to bear to be done twice. At an
    error, and when the caller stops, what has not begun is cancelled.

    Args:
        address: Of the scheduler, such as ``tcp://host:8786``, or its file (``.json``).
        work: A function of a module that the workers have too.
        items: Small things that can be pickled.
        say: Is told how many workers there are.

    Raises:
        ImportError: The package ``distributed`` is missing here, or dronepose on a worker.
        OSError: The scheduler cannot be reached or is gone, or an item's workers died.
        ValueError: The address is none.
        Exception: What ``work`` raises.
    """
    try:
        from distributed import Client, KilledWorker, as_completed
    except ImportError as error:
        raise ImportError(
            'working on a Dask cluster needs distributed: pip install "dronepose[cluster]"'
        ) from error
    where: dict[str, Any] = {"address": address}
    if address.endswith(".json"):
        where = {"scheduler_file": address}
    with Client(**where, set_as_default=False) as client:
        for worker, found in client.run(find_spec, "dronepose").items():
            if found is None:  # it would die of the first unit, and so would all others
                raise ImportError(f"{worker}: this worker has no dronepose; install it there too")
        threads = client.nthreads()
        workers = f"{len(threads)} workers with {sum(threads.values())} threads"
        say(f"rendering on {workers}" if threads else f"waiting for workers of {address}")
        waiting, pending = iter(items), set()

        def submit(count: int) -> list[Any]:
            new = [client.submit(work, item, pure=False) for item in islice(waiting, count)]
            pending.update(new)
            return new

        try:
            done = as_completed(submit(IN_FLIGHT), loop=client.loop)
            for future in done:
                result = future.result()
                pending.discard(future)
                for new in submit(1):
                    done.add(new)
                yield result
        except (CancelledError, KilledWorker, RuntimeError) as error:
            raise OSError(f"Dask cluster {address}: {error}") from error
        finally:
            if pending and client.status == "running":
                client.cancel(list(pending))
