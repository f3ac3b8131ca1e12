"""The exponential moving average of the actor, in evaluations and in files."""

import pytest
import torch
from support import models
from support.runs import only_run

from parking_exp.algorithms.model_files import read_weights
from parking_exp.algorithms.policy_ema import PolicyEMA
from parking_exp.config.compose import compose
from parking_exp.sweeps.single_run import train
from parking_exp.training import checkpoints

SMOKE = (
    "experiment=smoke",
    "algorithm=td3",
    "algorithm.policy_ema_half_life=20",
    "evaluation.video_episodes=0",
)


def make_model():
    return models.make_model(*SMOKE)


def actor(model):
    return [weight.detach().clone() for weight in model.actor.parameters()]


def set_actor(model, value, updates):
    model._n_updates = updates
    for weight in model.actor.parameters():
        weight.data.fill_(value)


def values(model):
    return {weight.unique().item() for weight in actor(model)}


@pytest.mark.parametrize("resumed", [False, True])
def test_the_weight_of_old_parameters_halves_in_a_half_life_of_updates(resumed):
    """Also if it was saved and loaded before it began."""
    model = make_model()
    average = PolicyEMA(model, half_life=10)
    if resumed:
        average.set_state(average.get_state())
    set_actor(model, 8.0, updates=4)
    with average.applied():
        assert values(model) == {8.0}
    set_actor(model, 0.0, updates=14)
    with average.applied():
        assert values(model) == {4.0}
    set_actor(model, 0.0, updates=34)
    average.update()
    with average.applied():
        assert values(model) == {1.0}
        average.update()  # no update of the model: nothing to take in
        assert values(model) == {1.0}
    with pytest.raises(KeyError), average.applied():
        raise KeyError
    assert values(model) == {0.0}  # also after an error


def test_without_a_half_life_or_an_update_the_actor_stays_as_it_is():
    model = make_model()
    before = actor(model)
    for average in (PolicyEMA(model, None), PolicyEMA(model, 10.0)):
        with average.applied():
            assert all(torch.equal(*pair) for pair in zip(before, actor(model), strict=True))


def weights(path):
    parameters, _ = read_weights(path, torch.device("cpu"))
    return [value for name, value in parameters["policy"].items() if name.startswith("actor.")]


def test_the_average_is_saved_as_the_final_model_and_not_trained_further(tmp_path):
    train(compose(*SMOKE, "total_timesteps=200", "tracking.mlflow=false", f"output_dir={tmp_path}"))
    run = only_run(tmp_path)
    last = checkpoints.latest(run.checkpoints)
    final, trained = (
        weights(path) for path in (run.models / "final.zip", last / checkpoints.MODEL)
    )
    averaged = checkpoints.load_state(last)["average"]
    assert [weight.tolist() for weight in final] == [weight.tolist() for weight in averaged]
    assert not all(map(torch.equal, final, trained))


def test_statistics_of_batch_normalisation_are_averaged_with_the_weights():
    model = make_model()
    model.actor.add_module("norm", torch.nn.BatchNorm1d(3))
    average = PolicyEMA(model, half_life=10)
    for updates, mean in ((4, 8.0), (14, 0.0)):
        model._n_updates = updates
        model.actor.norm.running_mean.fill_(mean)
        average.update()
    with average.applied():
        assert model.actor.norm.running_mean.tolist() == [4.0] * 3
    assert model.actor.norm.running_mean.tolist() == [0.0] * 3
