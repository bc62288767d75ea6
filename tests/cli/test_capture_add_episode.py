# SPDX-License-Identifier: MIT
from tests.station.drawn_push import draw_push, write_csv_log, write_drawn_capture, write_mp4


def test_an_episode_is_added_and_what_happened_is_told(pinwm, tmp_path):
    push = draw_push()
    capture = write_drawn_capture(tmp_path / "capture", push)
    video, log = write_mp4(tmp_path / "push.mp4", push.frames), write_csv_log(tmp_path / "robot.csv", push)
    options = ["--video", str(video), "--log", str(log), "--columns", "t=stamp[ms],px=x[mm],py=y[mm],pz=z[mm]"]
    options += ["--offset", str(push.offset), "--exact"]
    code, told, err = pinwm("capture", "add-episode", str(capture), *options, "--camera", str(capture / "camera.json"))
    assert code == 0
    assert "clock: the log's time is the film's +0.3700 s" in told
    assert f"wrote {capture}/episodes/0000: 48 images" in told.replace("\n", "")
    assert "no masks; identify refuses it" in err.replace("\n", " ")
    assert (capture / "episodes/0000/clock.yaml").is_file()


def test_options_that_do_not_fit_are_refused(pinwm, tmp_path):
    for options, words in (
        (["--exact"], "--exact: got True; allowed: with --offset only"),
        (["--start", "2", "--end", "1"], "--end: got 1.0; allowed: a time after --start"),
        (["--name", "a/b"], "--name: got a/b; allowed: the name of a folder"),
    ):
        code, _, err = pinwm("capture", "add-episode", str(tmp_path), "--video", "push.mp4", *options)
        assert code == 1
        assert words in err.replace("\n", " ")
