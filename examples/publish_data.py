"""Makes the datasets in examples/data: `python -m examples.publish_data` records them anew and compresses them."""

import os
import shutil
import tempfile
from pathlib import Path

import h5py

DATA = Path(__file__).with_name("data")


def compress(source: Path, target: Path) -> None:
    """Copies an HDF5 file with its datasets compressed, which Minari does not do and reads as any other."""
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


def main() -> None:
    """Records into a temporary folder, compresses, and only then takes the place of what is there."""
    with tempfile.TemporaryDirectory(dir=DATA.parent) as folder:
        os.environ["MINARI_DATASETS_PATH"] = folder
        from examples import minari_record

        minari_record.main()
        for file in Path(folder).rglob("*.hdf5"):
            compress(file, file.with_suffix(".small"))
            file.with_suffix(".small").replace(file)
        shutil.rmtree(DATA, ignore_errors=True)
        shutil.copytree(folder, DATA)


if __name__ == "__main__":
    main()
