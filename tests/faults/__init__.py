"""Kills, stops and starves trainings as a machine can, and counts what is lost: `python -m tests.faults`.

| fault | what must hold afterwards |
|---|---|
| kill -9 after a checkpoint, while one is written, at the start | checkpoints are whole or absent, and the run goes on to the policy of one that nobody disturbed, bit for bit, training at most one interval again |
| SIGTERM and Ctrl-C while training, importing and compiling, and Ctrl-C twice | no traceback, exit status 130, and the same policy |
| files that may not grow, folders that cannot be written to | one line that names them, and the run goes on once there is room |
| processes that compile at once for one empty cache | the same bits from all |

Everything is bounded: a process that does not end in time counts as broken. Needs Linux.
"""  # noqa: E501
