# SPDX-License-Identifier: MIT
import hashlib

import pytest
import torch
import yaml

from pinwm_drake.errors import InputError
from pinwm_drake.station.document import load_station, write_station
from pinwm_drake.station.named import require_station
from tests.station.stations import plain_station, station_document


def test_a_station_is_read_as_it_was_written(tmp_path):
    written = write_station(tmp_path / "new/station.yaml", station_document())
    read = load_station(tmp_path / "new")
    assert read.document == written.document == station_document()
    assert read.sha256 == hashlib.sha256((tmp_path / "new/station.yaml").read_bytes()).hexdigest()
    assert read.lens.intrinsics.tolist() == [918.3, 916.9, 652.2, 352.9]
    torch.testing.assert_close(read.X_WC.p, torch.tensor([0.55, -0.75, 0.6], dtype=torch.float64))
    assert not list((tmp_path / "new").glob(".*"))


def test_texts_that_look_like_numbers_stay_texts(tmp_path):
    document = station_document().model_copy(update={"name": "1e3", "provenance": {"sha256": "2028e68561dcfe65"}})
    read = write_station(tmp_path / "station.yaml", document).document
    assert (read.name, read.provenance) == ("1e3", {"sha256": "2028e68561dcfe65"})


@pytest.mark.parametrize(
    ("edit", "part"),
    [
        (lambda d: d.update(schema_version=2), "schema_version"),
        (lambda d: d.update(colour="red"), "an unknown key"),
        (lambda d: d["camera"].update(X_WC=None), "camera.mount"),
        (lambda d: d["camera"].update(mount="hand"), "X_EC"),
        (lambda d: d["camera"].update(distortion=[0.1]), "camera.distortion"),
        (lambda d: d["camera"]["K"][0].__setitem__(1, 0.5), "camera.K"),
        (lambda d: d["camera"].update(covariance=[[1.0]]), "15 x 15"),
        (lambda d: d["workspace"].update(high=[0.0, 0.0, 0.0]), "workspace.high"),
        (lambda d: d.update(latency={"camera": [0.2, 0.1]}), "latency.camera"),
        (lambda d: d["view"].update(fov_y=float("nan")), "view.fov_y"),
    ],
)
def test_wrong_stations_are_refused_by_name(tmp_path, edit, part):
    plain = plain_station()
    edit(plain)
    path = tmp_path / "station.yaml"
    path.write_text(yaml.safe_dump(plain))
    with pytest.raises(InputError) as caught:
        load_station(path)
    assert part in str(caught.value)


def test_another_station_is_refused(tmp_path):
    station = write_station(tmp_path / "station.yaml", station_document())
    require_station(tmp_path / "capture.yaml", station.sha256, station.sha256, station.path)
    require_station(tmp_path / "capture.yaml", None, station.sha256, station.path)
    with pytest.raises(InputError, match=r"capture\.yaml: got station 0000"):
        require_station(tmp_path / "capture.yaml", "0" * 64, station.sha256, station.path)
