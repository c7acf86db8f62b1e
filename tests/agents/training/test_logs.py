"""What a run writes while it trains, where it cannot."""

from __future__ import annotations

import threading

import pytest

from agents.training.logs import make_logger, told_once


def full(*_):
    raise OSError(28, "No space left on device")


# Pytest has a hook of its own for what threads let out.
@pytest.mark.filterwarnings("ignore::pytest.PytestUnhandledThreadExceptionWarning")
def test_a_full_disk_under_tensorboard_is_said_once_by_who_writes_next(tmp_path, monkeypatch):
    hooked = []
    monkeypatch.setattr(threading, "excepthook", hooked.append)
    with told_once():
        logger = make_logger(tmp_path, 0)
        events = logger.output_formats[1]
        writer = events.writer.file_writer.event_writer._async_writer
        monkeypatch.setattr(writer._writer, "write", full)
        with pytest.raises(OSError, match="No space left on device"):
            for step in range(100):
                logger.record("a", step)
                logger.dump(step)
        writer._worker.join()
        assert hooked == []
        # Whatever else a thread meets is said as ever.
        other = threading.Thread(target=full)
        other.start()
        other.join()
        assert [failure.thread for failure in hooked] == [other]
    assert threading.excepthook == hooked.append
