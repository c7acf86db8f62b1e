"""The paper's numbers compared with ours: `python -m baselines.paper [--figures DIR]`."""

import sys
from importlib.util import find_spec
from pathlib import Path

from capsule_gym.command_line import command


@command("python -m baselines.paper", ValueError)
def main(figures: Path | None = None) -> None:
    """Prints the paper's numbers and claims next to the computed ones; draws its figures.

    About a minute.

    Examples:
      python -m baselines.paper                           all tables
      python -m baselines.paper --figures docs/figures    and all figures, as SVG and PNG

    Args:
        figures: Also draw the figures into this folder, which is created if necessary (needs
            matplotlib).
    """
    if figures is not None:
        ancestors = (figures, *figures.absolute().parents)
        existing = next(path for path in ancestors if path.exists())
        if not existing.is_dir():
            raise ValueError(f"--figures must name a folder, got {str(figures)!r}")
        if find_spec("matplotlib") is None:
            raise ValueError("--figures needs matplotlib: pip install 'capsule-gym[paper]'")
    # Imported after parsing, since `--help` does not need these modules.
    from baselines.paper.report import compute, text

    print(text(compute()))
    if figures is not None:
        from baselines.paper.figures import draw_all

        print(f"\n{len(draw_all(figures))} files drawn to {figures}")


if __name__ == "__main__":
    sys.exit(main())
