# SPDX-License-Identifier: MIT
"""Work shared among processes: one `map`, whose results are kept on disk as they come, so that it can go on later."""

import multiprocessing
import os
import signal
import threading
import warnings
from collections import deque
from collections.abc import Callable, Generator, Iterable, Mapping, Sequence
from contextlib import AbstractContextManager, closing
from dataclasses import dataclass
from graphlib import TopologicalSorter
from multiprocessing.connection import Connection
from typing import Any, Generic, Protocol, TypeVar

from pinwm_drake.errors import ParameterError, PinwmError, require_package
from pinwm_drake.memory import memory
from pinwm_drake.threads import LIMIT, available, one_torch_thread

JOBLIB, RAY = "joblib", "ray"
EXECUTORS = (JOBLIB, RAY)
Item = TypeVar("Item")
Named = TypeVar("Named", contravariant=True)
Result = TypeVar("Result")
# Of a worker; torch takes OpenMP's.
_ONE_THREAD = dict.fromkeys(
    ("OMP_NUM_THREADS", "MKL_NUM_THREADS", "OPENBLAS_NUM_THREADS", "NUMBA_NUM_THREADS", LIMIT), "1"
)
_WORKER_MEMORY = 512 * 2**20  # bytes: 350 to 450 MB with Drake, torch and a scene
_RAY_RETRIES = 3  # of a task whose worker ended by itself


class Store(Protocol[Named, Result]):
    """Results on disk, one for each item. It is sent to the workers, so it holds plain data."""

    def read(self, item: Named) -> Result | None:
        """Return the item's result; None where there is none yet."""

    def write(self, item: Named, result: Result) -> None:
        """Keep a result, which appears whole or not at all."""

    def holding(self, item: Named) -> AbstractContextManager[object]:
        """Context in which an item is made; it may wait until no other process is in that of the same item."""


@dataclass(frozen=True)
class Executor:
    """Processes that share work.

    With joblib they are this machine's. With Ray they are this machine's too, or those of a cluster: one that the
    process is connected to already, or that `RAY_ADDRESS` names; its machines share the folder of a store. Ray gives
    the work of a worker or machine that was killed to another one, up to three times.

    Attributes:
        name: "joblib" or "ray".
        workers: Processes, each with one thread of torch, numba and BLAS; None for one on each core, and with joblib no
            more than the free memory has room for, which a warning says. With joblib, one worker is the process itself.
        option: What messages call the number of workers.

    Raises:
        ParameterError: A value is out of range, or Ray is asked for and not installed.
    """

    name: str = JOBLIB
    workers: int | None = None
    option: str = "--workers"

    def __post_init__(self) -> None:
        if self.name not in EXECUTORS:
            raise ParameterError(f"executor: got {self.name!r}; allowed: {', '.join(EXECUTORS)}")
        if self.name == RAY:
            require_package("ray", "ray", "executor")
        if self.workers is not None and self.workers < 1:
            raise ParameterError(f"{self.option}: got {self.workers}; allowed: 1 or more")

    def map(
        self,
        function: Callable[[Item], Result],
        items: Sequence[Item],
        *,
        needs: Callable[[Item], Iterable[Item]] = lambda item: (),
        store: Store[Item, Result] | None = None,
        on_result: Callable[[Item, Result], None] = lambda item, result: None,
        keep_going: bool = False,
    ) -> list[Result]:
        """Apply a function to every item whose result is not in the store yet.

        A worker writes each result to the store as soon as it is there. When this process or a worker is killed, or an
        item fails, only what was running is lost; a second call with the same store does the rest. Another call may
        share the store at the same time: what one of them makes, the other one takes. Workers end with the call, and
        with this process, whatever ends it.

        Args:
            function: A module's own, or a `functools.partial` of one; its arguments are plain data. Results depend on
                nothing but the arguments. What is expensive may stay in a variable of the module for later items, but
                workers of a cluster may serve several calls.
            items: What to apply it to.
            needs: The items that have to be done before one begins; they can be hashed, and are among `items`.
            store: Where results are kept; without one they come from worker to driver.
            on_result: Called in this process with each item and its result: those of the store, then each when done.
            keep_going: Flag: after a `PinwmError` of an item, those that do not need it are done before it is raised.

        Returns:
            The results in the order of the items, as the store has them where there is one.

        Raises:
            PinwmError: The function, or the store, refused something; with `keep_going` perhaps several things, which
                the message lists.
            ParameterError: A worker was killed; or a store is not where workers write to.
        """
        found: dict[int, Result] = {}
        if store is not None:
            for k, item in enumerate(items):
                kept = store.read(item)
                if kept is not None:
                    found[k] = kept
        for k, result in found.items():
            on_result(items[k], result)
        left = {k: item for k, item in enumerate(items) if k not in found}
        errors: list[PinwmError] = []
        with closing(self._share(_Work(function, store, keep_going), left, _order(left, needs), bool(found))) as done:
            for k, returned in done:
                if isinstance(returned, _Failed):
                    errors.append(returned.error)
                    continue
                one: Any = returned if store is None else store.read(items[k])
                if one is None and store is not None:
                    advice = "use a folder that all machines share"
                    raise ParameterError(f"store: the result of {items[k]} did not arrive in it; {advice}")
                found[k] = one
                on_result(items[k], one)
        if len(errors) > 1:
            raise PinwmError("; ".join(map(str, errors)))
        if errors:
            raise errors[0]
        return [found[k] for k in range(len(items))]

    def number(self, items: int) -> int:
        """Return the number of processes for so many items."""
        wanted = min(self.workers or available(), items)
        return wanted if self.workers else min(wanted, self._room(wanted))

    def _room(self, wanted: int) -> int:
        """Processes that the free memory has room for, at least one; all that are wanted where they are elsewhere."""
        total, free = memory()
        known = self.name == JOBLIB and total > 0 and wanted > 1
        return max(1, int(free / _WORKER_MEMORY)) if known else wanted

    def _warned(self, items: int) -> int:
        """Return the number of processes; warns where memory may be short for all that are wanted."""
        wanted, number = min(self.workers or available(), items), self.number(items)
        if (room := self._room(wanted)) < wanted:
            words = f"{self.option}: got {wanted}" if self.workers else f"{self.option}: {number} in place of {wanted}"
            warnings.warn(f"{words}; free memory has room for {room}", UserWarning, stacklevel=2)
        return number

    def _share(self, work: "_Work", items: dict[int, Any], order: "_Order", any_kept: bool) -> "_Done":
        workers = self._warned(len(items))
        try:
            if self.name == RAY and items:
                yield from _with_ray(work, items, order, workers)
            elif workers > 1:
                yield from _with_joblib(work, items, order, workers)
            else:
                yield from _here(work, items, order)
        except _WorkerEnded as error:
            store = work.store
            kept = store is not None and (any_kept or any(store.read(item) is not None for item in items.values()))
            again = "what is done is kept: go on with --resume" if kept else "start again"
            raise ParameterError(
                f"{self.option}: one of {workers} processes ended by itself, perhaps for want of memory; "
                f"{again}, with fewer {self.option}"
            ) from error


# The keys of items in the order in which they are done, each with what came back.
_Done = Generator[tuple[int, Any], None, None]
# Keys of items: an item is ready once those that it needs are done.
_Order = TopologicalSorter[int]


def _order(items: Mapping[int, Item], needs: Callable[[Item], Iterable[Item]]) -> _Order:
    before = {k: tuple(needs(item)) for k, item in items.items()}
    keys = {item: k for k, item in items.items()} if any(before.values()) else {}
    order: _Order = TopologicalSorter({k: [keys[one] for one in found if one in keys] for k, found in before.items()})
    order.prepare()
    return order


def _pass(order: _Order, done: Mapping[int, Any]) -> None:
    """Let those begin that need nothing but what is done."""
    order.done(*(k for k, result in done.items() if not isinstance(result, _Failed)))


class _WorkerEnded(Exception):
    """A worker was killed, or ran out of memory."""


@dataclass(frozen=True)
class _Failed:
    """Stand-in for the result of an item that was refused."""

    error: PinwmError


@dataclass(frozen=True)
class _Work(Generic[Item, Result]):
    """All that a worker does with an item."""

    function: Callable[[Item], Result]
    store: Store[Item, Result] | None
    keep_going: bool

    def __call__(self, item: Item) -> Result | _Failed | None:
        try:
            if self.store is None:
                return self.function(item)
            with self.store.holding(item):
                if self.store.read(item) is None:  # or another process made it meanwhile
                    self.store.write(item, self.function(item))
            return None
        except PinwmError as error:
            if not self.keep_going:
                raise
            return _Failed(error)


def _here(work: _Work, items: dict[int, Any], order: _Order) -> _Done:
    with one_torch_thread():
        while ready := order.get_ready():
            for k in ready:
                result = work(items[k])
                _pass(order, {k: result})
                yield k, result


def _with_joblib(work: _Work, items: dict[int, Any], order: _Order, workers: int) -> _Done:
    # joblib.Parallel would keep its workers for minutes, and use this process where it is called from a thread.
    from joblib.externals.loky import FIRST_COMPLETED, ProcessPoolExecutor, wait
    from joblib.externals.loky.process_executor import TerminatedWorkerError

    ends, lasts = multiprocessing.Pipe(duplex=False)
    pool = ProcessPoolExecutor(workers, initializer=_begin, initargs=(ends,), env=_ONE_THREAD)
    whole = False
    try:
        running = {pool.submit(work, items[k]): k for k in order.get_ready()}
        while running:
            ended = wait(running, return_when=FIRST_COMPLETED).done
            done = {running.pop(job): job.result() for job in ended}
            _pass(order, done)
            # Before the caller is told, who may take a while.
            running |= {pool.submit(work, items[k]): k for k in order.get_ready()}
            yield from done.items()
        whole = True
    except TerminatedWorkerError as error:
        raise _WorkerEnded from error
    finally:
        pool.shutdown(wait=True, kill_workers=not whole)
        lasts.close()
        ends.close()


def _begin(ends: Connection) -> None:
    """Make a worker end with the process that started it, and leave Ctrl-C to that."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    threading.Thread(target=_end_with, args=(ends,), daemon=True).start()


def _end_with(ends: Connection) -> None:
    try:
        ends.recv_bytes()
    except (EOFError, OSError):
        os._exit(1)


def _with_ray(work: _Work, items: dict[int, Any], order: _Order, workers: int) -> _Done:
    os.environ.setdefault("RAY_USAGE_STATS_ENABLED", "0")
    import ray

    mine = not ray.is_initialized()
    if mine:
        cluster = "RAY_ADDRESS" in os.environ
        ray.init(
            num_cpus=None if cluster else workers,
            include_dashboard=None if cluster else False,
            log_to_driver=False,
            logging_level="ERROR",
        )
    call = ray.remote(lambda work, item: work(item))
    call = call.options(num_cpus=1, max_retries=_RAY_RETRIES, runtime_env={"env_vars": _ONE_THREAD})
    shared, ready = ray.put(work), deque(order.get_ready())
    running: dict[Any, int] = {}

    def begin() -> None:
        while ready and len(running) < workers:
            k = ready.popleft()
            running[call.remote(shared, items[k])] = k

    try:
        begin()
        while running:
            (done,), _ = ray.wait(list(running), num_returns=1)
            result, at = ray.get(done), running.pop(done)
            _pass(order, {at: result})
            ready.extend(order.get_ready())
            begin()  # before the caller is told, who may take a while
            yield at, result
    except ray.exceptions.RayTaskError as error:
        raise error.cause from error
    except ray.exceptions.RayError as error:
        raise _WorkerEnded from error
    finally:
        if mine:
            ray.shutdown()
        else:
            for job in running:
                ray.cancel(job, force=True)
