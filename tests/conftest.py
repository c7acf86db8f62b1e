"""Hypothesis: a few examples, the same in every test run; many with `--hypothesis-profile fuzz`."""

import pytest
from hypothesis import HealthCheck, settings

settings.register_profile("seeded", derandomize=True, deadline=None, database=None, max_examples=20)
settings.register_profile(
    "fuzz",
    deadline=None,
    database=None,
    max_examples=300,
    suppress_health_check=list(HealthCheck),
    print_blob=True,
)
settings.load_profile("seeded")


@pytest.fixture
def refused(capsys):
    """Asserts that a command ends with status 2, and returns its standard error."""

    def call(main, *arguments):
        with pytest.raises(SystemExit) as stop:
            main(*arguments)
        assert stop.value.code == 2
        return capsys.readouterr().err

    return call


@pytest.fixture
def saved_figures(monkeypatch):
    """The figures of matplotlib that the test saves."""
    figure = pytest.importorskip("matplotlib.figure").Figure
    save = figure.savefig
    saved = []

    def record(self, *arguments, **options):
        saved.append(self)
        save(self, *arguments, **options)

    monkeypatch.setattr(figure, "savefig", record)
    return saved
