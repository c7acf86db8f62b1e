from agents.training.loop import make_env, make_model
from agents.training.runs import archive, unarchive
from tests.agents.training.sameness import parameters, same
from tests.agents.training.small import small


def test_an_agent_taken_out_of_its_archive_learns_as_before(tmp_path):
    config = small("direct", "ppo")
    env = make_env(config, 0)
    model = make_model(config, env)
    model.learn(512)
    path = tmp_path / "model.zip"
    path.write_bytes(archive(model))
    again = unarchive(path, "ppo", env)
    # The environments normalise; a second time would be once too often.
    assert again.policy_kwargs == model.policy_kwargs
    assert type(again.policy.features_extractor) is type(model.policy.features_extractor)
    (tmp_path / "again.zip").write_bytes(archive(again))
    assert same(parameters(path), parameters(tmp_path / "again.zip"))
    env.close()
