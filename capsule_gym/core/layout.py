"""The rows of `Simulation.world`, whose names `core/step/layout.hpp` defines.

The environments lie in one float64 array `world` of shape (blocks, rows, lanes). The first rows are
those of `Row`, one per quantity; a `Layout` names the first rows of the parts behind them, which
follow from the options of the environments. A batch has blocks of LANES environments, which are
stepped together; a single environment is a block of one lane. The arithmetic is the same, and so
are the results, bit for bit.
"""

from capsule_gym.core import _core

LANES = _core.LANES
ROW_NAMES = _core.ROW_NAMES
Row = _core.Row
Description = _core.Description
Layout = _core.Layout
Settings = _core.Settings

STATE = tuple(ROW_NAMES[: Row.M])
"""theta, theta_dot, x and x_dot, the first rows."""
NUM_ROWS = len(ROW_NAMES)
"""Number of rows before the law's memory."""
