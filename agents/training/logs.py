"""What a run writes while it trains: evaluations.csv, logs/progress.csv and TensorBoard's events.

A run that is gone on with from a checkpoint trains a part again. The lines of that part are cut off first, so that each
stands once.
"""

from __future__ import annotations

import csv
import io
import threading
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import Any

from stable_baselines3.common.logger import KVWriter, Logger, TensorBoardOutputFormat, filter_excluded_keys
from torch.utils.tensorboard import SummaryWriter

from agents.training.errors import RunError
from agents.training.presets import LOG, LOGGED, LOGS
from capsule_gym.files import canonical_hash, synchronise, write_atomically

# The name of the project at Weights & Biases.
PROJECT = "capsule_gym"


class Table(KVWriter):
    """A CSV file that lines are added to, each with a count of agent steps; also what SB3's logger writes to.

    SB3's own cannot go on with a file.

    Args:
        path: the file; what it holds already stays.
        steps: the column with the agent steps.
        until: lines with more of them are cut off, and a last one that is not whole.
    """

    def __init__(self, path: Path, steps: str, until: int) -> None:
        self.path = path
        self.columns: list[str] = []
        if path.is_file():
            rows = self._read()
            if steps in self.columns:
                self._rewrite([row for row in rows if row[steps].isdecimal() and int(row[steps]) <= until])
            else:
                self.columns = []

    def add(self, row: Mapping[str, Any]) -> None:
        """Adds a line; a column that is new is empty in the lines before."""
        new = [name for name in row if name not in self.columns]
        if new:
            before = self._read() if self.columns else []
            self.columns += new
            self._rewrite(before)
        with self.path.open("a", newline="", encoding="utf-8") as file:
            self._writer(file).writerow(row)

    def write(self, key_values: dict[str, Any], key_excluded: dict[str, tuple[str, ...]], step: int = 0) -> None:
        """A line of SB3's logger."""
        self.add(filter_excluded_keys(key_values, key_excluded, "csv"))

    def close(self) -> None:
        """Nothing is open between two lines."""

    def synchronise(self) -> None:
        """Waits until all lines are on the disk."""
        if self.path.is_file():
            synchronise(self.path)

    def _writer(self, file: Any) -> csv.DictWriter[str]:
        return csv.DictWriter(file, self.columns, lineterminator="\n")

    def _read(self) -> list[dict[str, str]]:
        """The lines that are whole."""
        text = self.path.read_text(encoding="utf-8", errors="replace")
        reader = csv.DictReader(io.StringIO(text[: text.rfind("\n") + 1], newline=""))
        self.columns = list(reader.fieldnames or ())
        return [row for row in reader if None not in row and None not in row.values()]

    def _rewrite(self, rows: Sequence[Mapping[str, Any]]) -> None:
        text = io.StringIO(newline="")
        writer = self._writer(text)
        writer.writeheader()
        writer.writerows(rows)
        write_atomically(self.path, text.getvalue())


class Events(TensorBoardOutputFormat):
    """TensorBoard's events; what other files of the folder hold of later steps is hidden.

    Args:
        folder: of the files.
        until: agent steps up to which they stay.
    """

    def __init__(self, folder: Path, until: int) -> None:
        self.writer = SummaryWriter(folder, purge_step=until + 1)
        self._is_closed = False


@contextmanager
def told_once() -> Iterator[None]:
    """While the block runs, an error of the system in TensorBoard's thread prints no traceback.

    The thread keeps it, and whoever writes next raises it.
    """
    before = threading.excepthook

    def hook(failure: threading.ExceptHookArgs) -> None:
        if not (isinstance(failure.exc_value, OSError) and type(failure.thread).__module__.startswith("tensorboard.")):
            before(failure)

    threading.excepthook = hook
    try:
        yield
    finally:
        threading.excepthook = before


class Dashboard(KVWriter):
    """What Weights & Biases is told: the lines of SB3's logger, by agent steps.

    Args:
        run: the run's folder, whose name it gets there.
        config: its settings.

    Raises:
        RunError: if wandb is not installed, or does not begin.
    """

    def __init__(self, run: Path, config: dict[str, Any]) -> None:
        try:
            import wandb
        except ImportError:
            raise RunError('--wandb needs wandb: pip install "capsule-gym[wandb]"') from None
        # The same folder with the same settings is the same run, gone on with.
        identity = canonical_hash([str(run.resolve()), {**config, "total_steps": None}])[:16]
        try:
            self._run = wandb.init(
                project=PROJECT, name=run.name, id=identity, resume="allow", config=config, dir=run / LOGS
            )
        except wandb.errors.Error as error:
            raise RunError(f"--wandb: {error}") from error

    def write(self, key_values: dict[str, Any], key_excluded: dict[str, tuple[str, ...]], step: int = 0) -> None:
        """A line of SB3's logger."""
        self._run.log(filter_excluded_keys(key_values, key_excluded, "wandb"), step=step)

    def close(self) -> None:
        """Nothing: a run of several stages has several loggers."""

    def finish(self) -> None:
        """Ends the run there."""
        self._run.finish()


@contextmanager
def watched(run: Path, config: dict[str, Any], wandb: bool) -> Iterator[list[KVWriter]]:
    """Where a run is logged besides its folder: nowhere, or at Weights & Biases while the block runs.

    Raises:
        RunError: if wandb is not installed, or does not begin.
    """
    if not wandb:
        yield []
        return
    (run / LOGS).mkdir(exist_ok=True)
    dashboard = Dashboard(run, config)
    try:
        yield [dashboard]
    finally:
        dashboard.finish()


def make_logger(run: Path, until: int, writers: Sequence[KVWriter] = ()) -> Logger:
    """SB3's logger for a run that goes on at that many agent steps; it also tells the writers."""
    folder = run / LOGS
    folder.mkdir(exist_ok=True)
    return Logger(str(folder), [Table(folder / LOG, LOGGED, until), Events(folder, until), *writers])
