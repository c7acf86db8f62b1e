"""Runs the notebooks and keeps what they show: `python notebooks`, which `make notebooks` runs.

A notebook whose cells show the same as before stays as it is: kept are neither the times of day at which cells ran nor
what is said while numba compiles, in a first run alone. One that fails stays, too, and ends the command.
"""

import time
from pathlib import Path

import nbformat
from nbclient import NotebookClient

from capsule_gym.files import write_atomically


def main() -> None:
    """Runs all of them, one after the other."""
    for path in sorted(Path(__file__).parent.resolve().glob("*.ipynb")):
        start = time.monotonic()
        notebook = nbformat.read(path, as_version=4)
        NotebookClient(notebook, record_timing=False, resources={"metadata": {"path": path.parent}}).execute()
        for cell in notebook.cells:
            cell.metadata.pop("execution", None)
            if cell.cell_type == "code":
                cell.outputs = [one for one in cell.outputs if "capsule_gym: compiling" not in one.get("text", "")]
        write_atomically(path, nbformat.writes(notebook) + "\n")
        print(f"{path.name}: {time.monotonic() - start:.0f} s", flush=True)


if __name__ == "__main__":
    main()
