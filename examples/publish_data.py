"""Makes the datasets in examples/data: `python -m examples.publish_data` records them anew and compresses them."""

from __future__ import annotations

import os
import shutil
import sys
import tempfile
from importlib.util import find_spec
from pathlib import Path
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    import h5py

PROG = "python -m examples.publish_data"
# What the extra `minari` brings, pillow for Minari's storage.
NEEDED = ("minari", "h5py", "PIL")
DATA = Path(__file__).with_name("data")


def compress(source: Path, target: Path) -> None:
    """Copies an HDF5 file with its datasets compressed, which Minari does not do and reads as any other."""
    import h5py

    with h5py.File(source) as old, h5py.File(target, "w") as new:
        new.attrs.update(old.attrs)

        def copy(name: str, item: h5py.Group | h5py.Dataset) -> None:
            if isinstance(item, h5py.Dataset):
                options = {"chunks": item.shape, "compression": "gzip", "compression_opts": 9, "shuffle": True}
                copied = new.create_dataset(name, data=item[...], **(options if item.shape else {}))
            else:
                copied = new.create_group(name)
            copied.attrs.update(item.attrs)

        old.visititems(copy)


def main() -> int:
    """Records into a temporary folder, compresses, and only then takes the place of what is there."""
    if not all(map(find_spec, NEEDED)):
        print(f'{PROG}: error: the datasets need Minari: pip install "capsule-gym[minari]"', file=sys.stderr)
        return 2
    with tempfile.TemporaryDirectory(dir=DATA.parent) as folder:
        os.environ["MINARI_DATASETS_PATH"] = folder
        from examples import minari_record

        minari_record.main()
        for file in Path(folder).rglob("*.hdf5"):
            compress(file, file.with_suffix(".small"))
            file.with_suffix(".small").replace(file)
        shutil.rmtree(DATA, ignore_errors=True)
        shutil.move(folder, DATA)
        Path(folder).mkdir()
    return 0


if __name__ == "__main__":
    sys.exit(main())
