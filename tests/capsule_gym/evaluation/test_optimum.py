import pytest

from capsule_gym.evaluation.optimum import GRID


@pytest.mark.parametrize(
    ("plant", "contained"),
    [
        ((0.35, 0.005), True),
        ((1.0, 0.5), True),
        ((0.34, 0.1), False),
        ((1.01, 0.1), False),
        ((0.5, 0.004), False),
        ((0.5, 0.51), False),
    ],
)
def test_a_grid_contains_the_plants_between_its_corners(plant, contained):
    assert (plant in GRID) is contained
