import pytest

from pinwm_drake.capture.episodes import read_episode
from pinwm_drake.capture.scene import read_capture
from pinwm_drake.errors import InputError
from pinwm_drake.paper.asid_twin import asid_twin
from pinwm_drake.paper.baselines.asid.cross_entropy import CrossEntropyBudget
from pinwm_drake.paper.baselines.asid.options import AsidOptions
from pinwm_drake.systems.scenario.load import load_setup
from pinwm_drake.twin.read import read_twin
from tests.identification.samples import write_appearance, write_capture

OPTIONS = AsidOptions(CrossEntropyBudget(samples=4, elites=2, rounds=2), num_threads=1)


def test_a_twin_is_written_that_scenes_take(tmp_path):
    capture = write_capture(tmp_path / "capture")
    write_appearance(tmp_path / "surfels")
    poses = [read_episode(read_capture(capture), "0000").object_poses]
    stages = []
    result = asid_twin(
        capture,
        tmp_path / "surfels",
        tmp_path / "twin",
        seed=0,
        options=OPTIONS,
        poses=poses,
        progress=lambda stage, done, figures: stages.append((stage, done)),
    )
    twin = read_twin(tmp_path / "twin")
    assert twin.theta == result.twin.theta
    assert twin.provenance["versions"]["pinwm_drake"]
    assert (tmp_path / "twin/episodes/0000.csv").is_file()
    assert sorted(path.name for path in (tmp_path / "surfels").iterdir()) == ["align.json", "surfels.ply"]
    assert stages == [("identifying", 0.0), ("identifying", 0.5), ("identifying", 1.0)]
    assert load_setup(tmp_path / "twin").twin.theta == twin.theta


def test_a_folder_without_surfels_is_refused(tmp_path):
    with pytest.raises(InputError, match="no surfels"):
        asid_twin(write_capture(tmp_path / "capture"), tmp_path, tmp_path / "twin", seed=0)
