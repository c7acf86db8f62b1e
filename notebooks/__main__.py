"""Runs the notebooks and stores their outputs: `python notebooks`, which `make notebooks` runs.

A notebook with unchanged outputs stays unchanged: execution times are not stored.
A notebook that fails also stays unchanged, and ends the command.
"""

import time
from pathlib import Path

import nbformat
from nbclient import NotebookClient

from capsule_gym.files import write_atomically


def main() -> None:
    """Runs all notebooks, one after the other."""
    for path in sorted(Path(__file__).parent.resolve().glob("*.ipynb")):
        start = time.monotonic()
        notebook = nbformat.read(path, as_version=4)
        NotebookClient(notebook, record_timing=False, resources={"metadata": {"path": path.parent}}).execute()
        for cell in notebook.cells:
            cell.metadata.pop("execution", None)
        write_atomically(path, nbformat.writes(notebook) + "\n")
        print(f"{path.name}: {time.monotonic() - start:.0f} s", flush=True)


if __name__ == "__main__":
    main()
