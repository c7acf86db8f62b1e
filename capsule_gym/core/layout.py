"""The rows of `Simulation.world`, whose names the core defines (`capsule_gym/core/step/layout.hpp`).

The environments lie in one float64 array `world` of shape (blocks, rows, lanes). Its rows are, in order:

- a row for each quantity of `Row`;
- the memory of the control law, and its row of the reference;
- the task's memory; varied plants have two, with true and with measured values, of which the law observes the first;
- for varied plants, the history of states that late sensors show;
- with observed estimates, the memory of the estimator of M and mu.

A batch has blocks of LANES environments, which are stepped together; a single environment is a block of one lane. The
arithmetic is the same, and so are the results, bit for bit.
"""

from types import SimpleNamespace

from capsule_gym.core import _core

LANES = _core.LANES
HISTORY_ROWS = _core.HISTORY_ROWS
NUM_ROWS = len(_core.ROW_NAMES)
"""Number of rows before the law's memory."""
Row = SimpleNamespace(**{name: row for row, name in enumerate(_core.ROW_NAMES)})
"""The row of each quantity."""
