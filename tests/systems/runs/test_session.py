# SPDX-License-Identifier: MIT
import pinwm_drake as pw
from pinwm_drake.systems.runs import session


def test_folders_of_what_is_written_are_made(tmp_path, monkeypatch):
    class Told:
        def __init__(self, setup, options):
            self.options = options

        def first(self):
            self.options.record.write_text("page")
            return "record"

    monkeypatch.setattr(session, "Session", Told)
    path = tmp_path / "some" / "where" / "push.html"
    options = pw.SessionOptions(record=path, video=tmp_path / "film" / "push.mp4")
    assert pw.simulate("push_t", options) == "record"
    assert path.read_text() == "page"
    assert (tmp_path / "film").is_dir()
