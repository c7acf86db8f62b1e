"""Threads that share a batch, and a process that is forked in the middle of a step."""

import copy
import os
import pickle
import threading
import time

import numpy as np
import pytest

from capsule_gym import CapsuleEnv, CapsuleVectorEnv
from capsule_gym.core.layout import LANES
from capsule_gym.envs.threads import Threads

BUSY = "another thread is using this batch"
CHANGES = [{"t": 0.1, "M": 0.5, "mu": 0.01}]
ACTIONS = np.full((LANES + 2, 1), 0.5, np.float32)


def start(**options):
    """A batch whose steps release the interpreter's lock for milliseconds."""
    batch = CapsuleVectorEnv(LANES + 2, physics_dt=1e-5, initial_noise=0.1, **options)
    batch.reset(seed=0)
    return batch


CALLS = {
    "step": lambda batch: batch.step(ACTIONS),
    "reset": lambda batch: batch.reset(seed=9, options={"changes": [CHANGES] * batch.num_envs}),
    "reset of the simulation": lambda batch: batch.simulation.reset(np.arange(batch.num_envs)),
    "copy": copy.deepcopy,
    "pickle": pickle.dumps,
    "metrics": lambda batch: batch.episode_metrics(),
    "close": lambda batch: batch.close(),
}


@pytest.mark.parametrize("name", CALLS)
def test_a_call_during_the_step_of_another_thread_is_refused(name):
    batch = start()
    alone = start()
    inside = threading.Event()
    after = threading.Event()

    def wait(first, last):
        inside.set()
        assert after.wait(60.0)
        return -1

    worker = threading.Thread(target=lambda: batch.simulation.run(wait))
    worker.start()
    assert inside.wait(60.0)
    with pytest.raises(RuntimeError, match=BUSY):
        CALLS[name](batch)
    after.set()
    worker.join()
    # Nothing has changed.
    np.testing.assert_array_equal(batch.step(ACTIONS)[0], alone.step(ACTIONS)[0])
    np.testing.assert_array_equal(batch.reset()[0], alone.reset()[0])
    CALLS[name](batch)


@pytest.mark.parametrize(
    ("count", "sizes"), [(1, [130]), (2, [64, 66]), (3, [64, 64, 2]), (7, [64, 64, 2])]
)
def test_every_thread_has_whole_blocks(count, sizes):
    threads = Threads(130, 64, count)
    assert threads.share(lambda first, last: last - first) == sizes
    threads.close()


def test_a_guarded_method_keeps_its_documentation():
    assert CapsuleVectorEnv.step.__doc__.startswith("One agent step of every environment.")


def test_threads_that_use_one_batch_at_once_work_or_are_refused():
    batch = start(threads=2)
    refused = []
    failed = []

    def use(calls):
        for _ in range(5):
            for call in calls:
                try:
                    call(batch)
                except RuntimeError as error:
                    refused.append(str(error))
                except BaseException as error:
                    failed.append(error)

    calls = list(CALLS.values())
    workers = [threading.Thread(target=use, args=(each,)) for each in (calls, calls[::-1])]
    for worker in workers:
        worker.start()
    for worker in workers:
        worker.join()
    assert not failed
    assert all(message.startswith(BUSY) for message in refused)
    batch.reset(seed=0)
    expected = start().step(ACTIONS)[0]
    np.testing.assert_array_equal(batch.step(ACTIONS)[0], expected)
    batch.close()


def test_work_whose_thread_cannot_start_is_never_done(monkeypatch):
    threads = Threads(3 * LANES, LANES, 3)
    done = []

    def work(first, last):
        time.sleep(0.01)
        done.append(first)
        return -1

    starting = threading.Thread.start
    started = []

    def fail_second(thread):
        started.append(thread)
        if len(started) == 2:
            raise RuntimeError("can't start new thread")
        starting(thread)

    with monkeypatch.context() as patch:
        patch.setattr(threading.Thread, "start", fail_second)
        with pytest.raises(RuntimeError, match="can't start"):
            threads.share(work)
    before = list(done)
    time.sleep(0.05)
    assert done == before
    done.clear()
    assert threads.share(work) == [-1] * 3
    assert sorted(done) == [0, LANES, 2 * LANES]
    threads.close()


@pytest.mark.skipif(not hasattr(os, "fork"), reason="needs fork")
@pytest.mark.filterwarnings("ignore::DeprecationWarning")
def test_a_process_forked_in_the_middle_of_a_step_has_environments_of_its_own():
    batch = start(threads=2)
    stop = threading.Event()

    def step():
        while not stop.is_set():
            batch.step(ACTIONS)

    worker = threading.Thread(target=step)
    worker.start()
    time.sleep(0.05)
    child = os.fork()
    if child == 0:
        status = 1
        try:
            env = CapsuleEnv()
            env.reset(seed=0)
            env.step(np.zeros(1, np.float32))
            own = start(threads=2)
            own.step(ACTIONS)
            status = 0
        finally:
            os._exit(status)
    _, status = os.waitpid(child, 0)
    stop.set()
    worker.join()
    assert os.waitstatus_to_exitcode(status) == 0
    batch.close()
