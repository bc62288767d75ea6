import pytest
import yaml

from pinwm_drake.errors import InputError
from pinwm_drake.learning.bundle import read_bundle
from pinwm_drake.learning.evaluation import evaluate
from pinwm_drake.learning.spec import PolicySpec
from pinwm_drake.models import policy_path, shipped_policies
from pinwm_drake.systems.envs.policy_scene import spec_environment
from pinwm_drake.tasks import PushTask


@pytest.mark.parametrize("name", shipped_policies())
def test_a_shipped_policy_is_small_and_sound(name):
    folder = policy_path(name)
    assert sum(path.stat().st_size for path in folder.iterdir()) <= 5e6
    bundle = read_bundle(folder)
    assert bundle.spec.observes == "rgb"


def test_the_policy_of_the_push_task_pushes_in_a_plant_that_it_was_not_trained_in():
    bundle = read_bundle(policy_path("push_t"))
    assert evaluate(spec_environment(bundle.spec, "push_t", "point"), bundle, range(3)).successes == 3


def test_a_bundle_of_version_1_has_the_push_task_and_its_golden_answers():
    folder = policy_path("push_t")
    stored = yaml.safe_load((folder / "contract.yaml").read_text())
    assert stored["schema_version"] == 1
    bundle, spec = read_bundle(folder), stored["spec"]  # which compares the golden samples
    assert bundle.spec.task == PushTask(
        goal=tuple(spec["goal"]),
        q_WO=tuple(spec["q_WO"]),
        tolerance=spec["tolerance"],
        turn_tolerance=spec["turn_tolerance"],
    )
    assert bundle.spec.pusher_low == tuple(spec["pusher_low"])
    assert bundle.contract["schema_version"] == 2
    assert PolicySpec.from_document(bundle.spec.to_document()) == bundle.spec


def test_a_folder_goes_before_a_shipped_name(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    shipped = policy_path("push_t")
    assert shipped.is_absolute()
    (tmp_path / "push_t").mkdir()
    assert policy_path("push_t").resolve() == (tmp_path / "push_t").resolve()


def test_a_policy_that_is_not_there_is_refused():
    with pytest.raises(InputError, match="push_t"):
        policy_path("no_such_policy")
