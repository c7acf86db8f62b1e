"""What a command answers with one line instead of a traceback."""

from __future__ import annotations


class RunError(ValueError):
    """A run that cannot be begun or gone on with: the message names the option or the file, and says why."""
