# SPDX-License-Identifier: MIT
import signal
import socket
import subprocess
import sys
import time
import urllib.request
from pathlib import Path

import cv2
import pytest

from pinwm_drake.rendering.ply import write_ply
from pinwm_drake.report.surfels.live_view import twin_solids
from pinwm_drake.twin.write import write_twin
from tests.rendering.scenes import cloud
from tests.twin.samples import cube_twin

ROOT = Path(__file__).resolve().parents[2]


@pytest.fixture
def splats(tmp_path):
    path = tmp_path / "surfels.ply"
    write_ply(path, cloud())
    return path


def test_a_page_and_a_video_are_written(pinwm, splats, tmp_path):
    page, video = tmp_path / "new/a.html", tmp_path / "new/a.mp4"
    arguments = ["--html", str(page), "--video", str(video), "--size", "32", "--seconds", "0.25"]
    code, output, errors = pinwm("view", str(splats.parent), *arguments)
    assert (code, errors) == (0, "")
    assert f"wrote {page}\n" in output
    assert f"wrote {video}\n" in output
    assert "renderSurfels" in page.read_text()
    reader = cv2.VideoCapture(str(video))
    assert reader.get(cv2.CAP_PROP_FRAME_COUNT) == 6
    assert reader.get(cv2.CAP_PROP_FRAME_WIDTH) == 32
    assert sorted(path.name for path in page.parent.iterdir()) == ["a.html", "a.mp4", "a.view.config.yaml"]


def test_a_twin_that_ships_is_shown_by_its_name(pinwm, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    assert pinwm("view", "t_block", "--html", "a.html") == (0, "wrote a.html\n", "")
    assert (tmp_path / "a.html").stat().st_size > 10_000


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (["--html", "a.txt"], "--html: got a.txt; allowed: a name that ends in .html or .htm"),
        (["--video", "a.avi"], "--video: got a.avi; allowed: a name that ends in .mp4"),
        (["--size", "33"], "--size: got 33; allowed: an even number from 16 to 4096 px"),
        (["--seconds", "0"], "--seconds: got 0.0; allowed: 0.1 to 600 s"),
        (["--port", "70000"], "--port: got 70000; allowed: 1 to 65535"),
    ],
)
def test_wrong_options_are_one_line_and_exit_with_1(pinwm, splats, arguments, message):
    assert pinwm("view", str(splats), *arguments) == (1, "", f"pinwm: {message}\n")


def test_wrong_files_are_refused(pinwm, splats, tmp_path):
    code, output, errors = pinwm("view", str(tmp_path / "nothing.ply"), "--html", str(tmp_path / "a.html"))
    assert (code, output) == (1, "")
    assert "nothing.ply: no such file; allowed: a PLY file of surfels" in errors
    splats.write_bytes(splats.read_bytes()[:-10])
    code, output, errors = pinwm("view", str(splats), "--html", str(tmp_path / "a.html"))
    assert (code, output) == (1, "")
    assert f"{splats}: got a truncated file" in errors
    assert not (tmp_path / "a.html").exists()


def test_a_page_where_a_folder_is_gets_refused_before_the_work(pinwm, splats, tmp_path):
    (tmp_path / "a.mp4").mkdir()
    code, output, errors = pinwm("view", str(splats), "--video", str(tmp_path / "a.mp4"))
    assert (code, output, errors) == (1, "", f"pinwm: {tmp_path / 'a.mp4'}: got a folder; allowed: a file\n")


def test_a_port_that_is_taken_is_refused(pinwm, splats):
    with socket.socket() as other:
        other.bind(("127.0.0.1", 0))
        other.listen()
        port = str(other.getsockname()[1])
        code, output, errors = pinwm("view", str(splats), "--port", port)
    assert (code, output) == (1, "")
    assert f"--host, --port: got 127.0.0.1:{port} (Address already in use)" in errors


def test_an_address_of_another_machine_is_refused(pinwm, splats):
    # TEST-NET-1 of RFC 5737: no machine has it.
    code, output, errors = pinwm("view", str(splats), "--host", "192.0.2.1")
    assert (code, output) == (1, "")
    assert "--host, --port: got 192.0.2.1" in errors


def listening(process: subprocess.Popen) -> set[tuple[str, int]]:
    """Address and port of every TCP socket on which a process listens."""
    mine = {link.readlink().name for link in Path(f"/proc/{process.pid}/fd").iterdir() if link.is_symlink()}
    found = set()
    for table in ("tcp", "tcp6"):
        path = Path(f"/proc/{process.pid}/net/{table}")
        for line in path.read_text().splitlines()[1:] if path.exists() else ():
            fields = line.split()
            if fields[3] == "0A" and f"socket:[{fields[9]}]" in mine:
                address, port = fields[1].split(":")
                found.add((address, int(port, 16)))
    return found


@pytest.mark.nightly
@pytest.mark.skipif(not Path("/proc/self/net/tcp").exists(), reason="needs Linux's table of sockets")
def test_the_server_listens_on_this_machine_only_and_ends_cleanly(splats):
    command = [sys.executable, "-c", "from pinwm_drake.cli import main; main()", "view", str(splats)]
    process = subprocess.Popen(command, cwd=ROOT, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True)
    try:
        line = process.stdout.readline()
        url = line.split()[-1]
        assert line.startswith(f"{splats}: 60 surfels at http://127.0.0.1:")
        port = int(url.split(":")[2].split("/")[0])
        # 127.0.0.1 in the kernel's byte order; nothing else listens, for commands either.
        assert listening(process) == {("0100007F", port)}
        with urllib.request.urlopen(url, timeout=30) as page:
            assert b"MeshCat" in page.read()
        message = receive_scene(port)
        assert b"surfels" in message
        assert b"BufferGeometry" in message
        for part in (b"/meshcat/surfels/cores", b"/meshcat/surfels/rims", b"uv", b"data:image/png"):
            assert part in message
        process.send_signal(signal.SIGINT)
        assert process.wait(timeout=30) == 0
        # Not `communicate`, which would miss what `readline` has already taken from the pipe.
        output, errors = process.stdout.read(), process.stderr.read()
        assert output == "Ctrl-C ends.\n"
        assert "Traceback" not in errors
    finally:
        process.kill()
        process.wait()


# None stands for a module that cannot be imported: so it is where Drake is not installed.
WITHOUT_DRAKE = "import sys; sys.modules['pydrake'] = None; from pinwm_drake.cli import main; main()"


@pytest.mark.skipif(not Path("/proc/self/net/tcp").exists(), reason="needs Linux's table of sockets")
def test_a_twin_is_served_with_its_mesh_and_its_pusher_without_drake(tmp_path):
    folder = tmp_path / "twin"
    write_twin(folder, cube_twin(tmp_path))
    process = subprocess.Popen(
        [sys.executable, "-c", WITHOUT_DRAKE, "view", str(folder)], cwd=ROOT, stdout=subprocess.PIPE, text=True
    )
    try:
        line = process.stdout.readline()
        assert line.startswith(f"{folder}: ")
        assert " surfels, mesh, pusher at http://127.0.0.1:" in line
        port = int(line.split()[-1].split(":")[2].split("/")[0])
        assert listening(process) == {("0100007F", port)}
        message = receive_scene(port)
        for name in (b"/meshcat/surfels", b"/meshcat/mesh", b"/meshcat/pusher"):
            assert name in message
        process.send_signal(signal.SIGINT)
        assert process.wait(timeout=30) == 0
    finally:
        process.kill()
        process.wait()


def test_of_a_twin_the_page_shows_the_surfels(pinwm, tmp_path):
    folder = tmp_path / "twin"
    write_twin(folder, cube_twin(tmp_path))
    assert pinwm("view", str(folder), "--html", str(tmp_path / "a.html"))[::2] == (0, "")
    # A twin whose files were changed is no twin.
    (folder / "surfels.ply").write_bytes(b"")
    code, _, errors = pinwm("view", str(folder), "--html", str(tmp_path / "b.html"))
    assert code == 1
    assert "surfels.ply" in errors


def test_the_pusher_stands_beside_the_object_on_its_level(tmp_path):
    twin = cube_twin(tmp_path)
    mesh, pusher = (solid.mesh for solid in twin_solids(twin))
    assert pusher.bounds[0, 0] > mesh.bounds[1, 0]
    assert pusher.bounds[0, 2] == pytest.approx(mesh.bounds[0, 2])
    assert pusher.bounds[:, 1].mean() == pytest.approx(mesh.bounds[:, 1].mean())


def receive_scene(port: int) -> bytes:
    """What the server sends a browser that connects, up to the last command, which places the camera."""
    with socket.create_connection(("127.0.0.1", port), timeout=30) as connection:
        request = [
            "GET / HTTP/1.1",
            f"Host: 127.0.0.1:{port}",
            "Upgrade: websocket",
            "Connection: Upgrade",
            "Sec-WebSocket-Version: 13",
            "Sec-WebSocket-Key: AAAAAAAAAAAAAAAAAAAAAA==",
        ]
        connection.sendall(("\r\n".join(request) + "\r\n\r\n").encode())
        data, deadline = b"", time.monotonic() + 30
        while b"/Cameras/default" not in data and time.monotonic() < deadline:
            data += connection.recv(65536)
        return data
