"""Injects a machine's faults into trainings and counts the lost steps: `python -m tests.faults`.

| fault | expected result |
|---|---|
| kill -9 after a checkpoint, while one is written, at the start | checkpoints are complete or absent; the resumed run ends with the policy of an undisturbed run, bit for bit, and repeats at most one interval |
| SIGTERM and Ctrl-C while training and importing, and Ctrl-C twice | no traceback, exit status 130, and the same policy |
| files that may not grow, folders that cannot be written to | one line names them, and the run can be resumed once there is room |

Every wait is bounded: a process that does not end in time counts as broken. Needs Linux.
"""  # noqa: E501
