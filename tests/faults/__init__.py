"""Breaks trainings and caches in every way a machine can, and counts what is lost: `python -m tests.faults`.

| fault | what must hold afterwards |
|---|---|
| `kill` | kill -9, most after a checkpoint, some while one is written, some at the start: checkpoints are whole or absent, and the run goes on to the policy of one that nobody disturbed, bit for bit, training at most one interval again |
| `stop` | SIGTERM and Ctrl-C while training, importing and compiling, and Ctrl-C twice: no traceback, exit status 130, and the same policy |
| `disk` | a file that may not grow and a file system that is full: one line that names the file, and the run goes on once there is room |
| `readonly` | folders that cannot be written to: one line that names them |
| `processes` | processes that compile at once for one empty cache: the same bits from all |
| `cache` | a cache that is truncated, garbled, changed by a bit, emptied on the way or read-only: the same bits |
| `fork` | a process forked from one whose threads have run: it steps on, with the same bits |

Everything is bounded: a process that does not end in time counts as broken. Needs Linux.
"""  # noqa: E501
