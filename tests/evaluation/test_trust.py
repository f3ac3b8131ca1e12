"""A run that names classes of the user's own executes them only for a user who trusts it."""

import pytest
from support.runs import call_script, evaluate_stored, make_config
from support.sweep_processes import QUICK

from parking_exp import load_model
from parking_exp.errors import UntrustedError
from parking_exp.training.train_run import train

TARGET = "algorithm._target_=support.user_algorithms.SavesExtraNetwork"
REFUSAL = (
    rf"^{TARGET} in .* is not on the allow-list; {{option}} allows it, if you trust its author$"
)


def test_a_run_with_a_class_of_the_users_own_is_used_once_it_is_trusted(tmp_path):
    config = make_config(*QUICK, TARGET, f"output_dir={tmp_path}")
    train(config)
    run = config.run_dir
    with pytest.raises(UntrustedError, match=REFUSAL.format(option="trust=true")):
        evaluate_stored(run)
    with pytest.raises(UntrustedError, match=REFUSAL.format(option="trust=True")):
        load_model(str(run))
    export = ("export", f"run='{run}'", "format=safetensors")
    assert "trust=true" in call_script(*export).stderr
    assert not (run / "evaluations").exists()
    assert not (run / "exports").exists()

    evaluate_stored(run, "trust=true")
    assert type(load_model(str(run), trust=True)).__name__ == "SavesExtraNetwork"
    assert call_script(*export, "trust=true").returncode == 0
