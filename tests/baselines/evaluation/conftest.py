from tests.agents.conftest import tiny_file, world

__all__ = ["tiny_file", "world"]
