"""Export of policies and control laws as C99 and as ONNX."""

from collections.abc import Sequence


def main(arguments: Sequence[str] | None = None) -> int:
    """Runs the command `python -m capsule_gym.export`.

    Args:
        arguments: the words after the command; None takes them from `sys.argv`.

    Returns:
        The exit status.
    """
    # Imported here, since it needs an extra, which its error names only once the command runs.
    from capsule_gym.export.command import main as run

    return run(arguments)
