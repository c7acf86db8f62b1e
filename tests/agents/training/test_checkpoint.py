"""The lock of a run's folder, and the git revision of its start."""

import errno
from unittest.mock import Mock

import filelock
import pytest

from agents.training import checkpoint
from agents.training.checkpoint import git_revision, locked


def test_a_file_system_without_locks_is_a_warning(tmp_path, monkeypatch, capsys):
    without_locks = Mock(side_effect=OSError(errno.ENOLCK, "No locks available"))
    monkeypatch.setattr(filelock.FileLock, "acquire", without_locks)
    with locked(tmp_path):
        pass
    warning = "this file system has no locks; make sure that no second process trains it"
    assert capsys.readouterr().err == f"{tmp_path}: {warning}\n"


def test_a_folder_that_cannot_be_written_to_is_an_error(tmp_path, monkeypatch):
    read_only = Mock(side_effect=OSError(errno.EROFS, "Read-only file system"))
    monkeypatch.setattr(filelock.FileLock, "acquire", read_only)
    with pytest.raises(OSError, match="Read-only"), locked(tmp_path):
        pass


def test_the_revision_is_that_of_this_checkout(tmp_path, monkeypatch):
    here = git_revision()
    monkeypatch.chdir(tmp_path)
    assert git_revision() == here


def test_the_revision_outside_a_checkout_is_unknown(tmp_path, monkeypatch):
    monkeypatch.setenv("GIT_CEILING_DIRECTORIES", str(tmp_path.parent))
    monkeypatch.setattr(checkpoint, "__file__", str(tmp_path / "checkpoint.py"))
    assert git_revision() == "unknown"
