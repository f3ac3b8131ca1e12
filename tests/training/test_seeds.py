"""Seeds of the parts of a run follow from its own."""

from parking_exp.config.compose import compose
from parking_exp.training.seeds import derive_seeds


def test_seeds_of_parking_stay_what_they_were_since_published_policies_depend_on_them():
    seeds = derive_seeds(0, compose().env.training_seeds)
    assert seeds.training_envs == 3677149159
