from tests.agents.conftest import world as world
