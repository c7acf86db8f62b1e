"""Export of policies and control laws as C99 and as ONNX."""

from collections.abc import Sequence


def main(arguments: Sequence[str] | None = None) -> int:
    """The command `python -m capsule_gym.export`: takes the words after the command, and returns
    the exit status.
    """
    # Imported here, since it needs an extra, which its error names only once the command runs.
    from capsule_gym.export.command import main as run

    return run(arguments)
