"""Throws arguments, options, states and actions at the environments until something breaks: `python -m tests.fuzz`.

A case is a number, which seeds everything that happens in it: it makes one environment or one batch, mostly from valid
arguments and with a hostile one here and there, and then resets, steps, copies, pickles, draws and closes it. `--replay`
runs one again.

| counts as a failure | |
|---|---|
| the interpreter | a process that ends |
| a hang | a case that takes minutes |
| an unnamed error | an exception that is no `ValueError`, `TypeError` or `ResetNeeded`, or that names none of the call's arguments |
| not finite | a number that is infinite or NaN, but for the ratios of an episode's metrics that may be |
| outside | an observation outside its space |
| layout | an info whose keys, types or shapes change from call to call |
| a copy | a copy of an environment that goes another way than its original |

Cases run in processes of their own, so that one that ends counts and is replaced.
"""  # noqa: E501
