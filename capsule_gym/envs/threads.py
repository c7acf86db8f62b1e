"""Threads that work on parts of a batch."""

import os
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor, wait
from itertools import pairwise


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
        futures = [self._pool.submit(work, *bounds) for bounds in others]
        try:
            # The calling thread takes a part too, so one thread less has to be woken up.
            own = work(first, last)
            return [own, *(future.result() for future in futures)]
        except BaseException:
            # The caller may change what the other threads still write.
            wait(futures)
            raise

    def close(self) -> None:
        """Ends the threads."""
        if self._pool is not None and self._owner == os.getpid():
            self._pool.shutdown()
        self._pool = None
