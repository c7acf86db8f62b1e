import pytest

from capsule_gym.command_line import check_output


def test_an_output_file_that_exists_is_overwritten_only_on_request(tmp_path):
    path = tmp_path / "table.csv"
    path.touch()
    check_output("--output", path, overwrite=True)
    with pytest.raises(ValueError, match="--output must name a new file unless --overwrite"):
        check_output("--output", path)
