# SPDX-License-Identifier: MIT
import hashlib
import json
import warnings

import pytest

from pinwm_drake.errors import InputError
from pinwm_drake.rendering.ply import write_ply
from pinwm_drake.report.surfels.fit_results import read_offset
from tests.rendering.scenes import cloud


@pytest.fixture
def fitted(tmp_path):
    write_ply(tmp_path / "surfels.ply", cloud(20))
    sha256 = hashlib.sha256((tmp_path / "surfels.ply").read_bytes()).hexdigest()
    record = {"camera_offset": [0.5, -0.25], "surfels_sha256": sha256}
    (tmp_path / "align.json").write_text(json.dumps(record))
    return tmp_path


def test_surfels_of_another_fit_are_refused(fitted):
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        assert read_offset(fitted / "align.json") == (0.5, -0.25)
    write_ply(fitted / "surfels.ply", cloud(20, seed=2))
    with pytest.raises(InputError, match=r"surfels\.ply: got SHA-256 [0-9a-f]{12}; allowed: .* as align\.json"):
        read_offset(fitted / "align.json")


def test_a_file_of_version_01_is_read_with_a_warning(fitted):
    (fitted / "align.json").write_text(json.dumps({"camera_offset": [0.5, -0.25]}))
    with pytest.warns(UserWarning, match=r"^[^\n]*align\.json: no surfels_sha256: surfels of another fit"):
        assert read_offset(fitted / "align.json") == (0.5, -0.25)
