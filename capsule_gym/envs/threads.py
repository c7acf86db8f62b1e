"""Threads that work on parts of a batch, and the guard against a second one that uses it."""

import os
from collections.abc import Callable
from concurrent.futures import Future, ThreadPoolExecutor, wait
from functools import wraps
from itertools import pairwise
from typing import Any, Concatenate, ParamSpec, TypeVar

Parameters = ParamSpec("Parameters")
Result = TypeVar("Result")
Method = Callable[Concatenate[Any, Parameters], Result]


class Threads:
    """Distributes the environments of a batch over threads, which start with the first work.

    Args:
        num_envs: number of environments.
        lanes: number of environments in a block.
        count: largest number of threads.
    """

    def __init__(self, num_envs: int, lanes: int, count: int) -> None:
        blocks = -(-num_envs // lanes)
        parts = min(count, blocks)
        # Each thread has whole blocks, so that two threads never write to the same block.
        edges = [min(num_envs, lanes * (blocks * n // parts)) for n in range(parts + 1)]
        self._ranges = list(pairwise(edges))
        self._pool: ThreadPoolExecutor | None = None
        # The process that owns the threads.
        self._owner = os.getpid()

    def share(self, work: Callable[[int, int], int]) -> list[int]:
        """The results of `work(first, last)`, which the threads call for parts of the batch."""
        (first, last), *others = self._ranges
        if not others:
            return [work(first, last)]
        # A forked process inherits the pool, but none of its threads.
        if self._pool is None or self._owner != os.getpid():
            self._owner = os.getpid()
            self._pool = ThreadPoolExecutor(len(others), thread_name_prefix="capsule")
        futures: list[Future[int]] = []
        try:
            for bounds in others:
                futures.append(self._pool.submit(work, *bounds))
            # The calling thread takes a part too, so one thread less has to be woken up.
            own = work(first, last)
            return [own, *(future.result() for future in futures)]
        except BaseException:
            # The caller may change what the other threads still write.
            wait(futures)
            if len(futures) < len(others):
                # Work whose thread could not start would wait for the next one.
                self._pool.shutdown(cancel_futures=True)
                self._pool = None
            raise

    def close(self) -> None:
        """Ends the threads."""
        if self._pool is not None and self._owner == os.getpid():
            self._pool.shutdown()
        self._pool = None


def single_use(method: Method[Parameters, Result]) -> Method[Parameters, Result]:
    """Lets one thread at a time into the methods of an object, which has the lock `in_use`.

    Raises:
        RuntimeError: if another thread is in one of them.
    """

    @wraps(method)
    def guarded(self: Any, *args: Parameters.args, **kwargs: Parameters.kwargs) -> Result:
        lock = self.in_use
        # Waiting would mix the steps of both threads, and in a forked process last for ever.
        if not lock.acquire(blocking=False):
            raise RuntimeError("another thread is using this batch: each needs its own, or a lock")
        try:
            return method(self, *args, **kwargs)
        finally:
            lock.release()

    return guarded
