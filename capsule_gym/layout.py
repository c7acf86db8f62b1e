"""The rows of `Simulation.world`, whose names the core defines (`capsule_gym/core/step/layout.hpp`).

The environments lie in one float64 array `world` of shape (blocks, rows, lanes): one row per quantity of `Row`, then
the memory of the control law, its row of the reference, the task's memory, and the history of states that late sensors
show. A batch has blocks of LANES environments, which are stepped together; a single environment is a block of one
lane. The arithmetic is the same, and so are the results, bit for bit.
"""

from types import SimpleNamespace

from capsule_gym import _core

LANES = _core.LANES
HISTORY_ROWS = _core.HISTORY_ROWS
ROWS = len(_core.ROW_NAMES)
"""Number of rows before the law's memory."""
Row = SimpleNamespace(**{name: row for row, name in enumerate(_core.ROW_NAMES)})
"""The row of each quantity."""
