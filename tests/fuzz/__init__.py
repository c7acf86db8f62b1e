"""Calls environments with random and invalid arguments, options, states and actions: `python -m tests.fuzz`.

A case is a number, which seeds everything in it: it makes one environment or one batch, mostly from valid arguments and
some invalid ones, and then resets, steps, copies, pickles, renders and closes it. `--replay` runs one case again.

These count as failures: a process that ends or hangs; an exception that is no `ValueError`, `TypeError` or
`ResetNeeded`, or that names none of the call's arguments; a number that is infinite or NaN, except for those ratios of
an episode's metrics that may be; an observation outside its space; an info whose keys, types or shapes change from call
to call; a copy of an environment that gives other results than its original.
"""
