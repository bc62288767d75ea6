# SPDX-License-Identifier: MIT
"""No module of the package opens a file of a user by another way than `pinwm_drake.reading`."""

import ast
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parents[2]
PACKAGE = ROOT / "pinwm_drake"
SOURCES = (PACKAGE, ROOT / "systems", ROOT / "models")  # the last two are linked into the package

# Calls that read a file or parse its contents, by the last two parts of their names.
READERS = {
    "np.load",
    "np.loadtxt",
    "np.genfromtxt",
    "np.fromfile",
    "np.memmap",
    "format.read_array",
    "json.load",
    "json.loads",
    "yaml.load",
    "yaml.safe_load",
    "yaml.unsafe_load",
    "yaml.full_load",
    "zipfile.ZipFile",
    "csv.reader",
    "csv.DictReader",
    "pickle.load",
    "pickle.loads",
    "torch.load",
    "onnx.load",
    "onnx.load_from_string",
    "cv2.imread",
    "cv2.imdecode",
    "cv2.VideoCapture",
    "Image.open",
    "trimesh.load",
    "trimesh.load_mesh",
    "trimesh.load_scene",
    "os.open",
}
NAMES = {"load_ply", "load_obj", "load_stl", "load_glb", "ZipFile"}
METHODS = {"read_text", "read_bytes"}
# Files that no user gives, each with the call that reads them.
EXCEPTIONS = {
    ("jit.py", "path.read_bytes"),  # sources of the package
    ("jit.py", "stamp.read_text"),  # stamp of the cache of kernels
    ("jit.py", ".read_text"),  # the same of another folder
    ("files.py", ".read_text"),  # the lock of a run, for a message
    ("experiments/doctor.py", ".read_text"),  # /proc and /sys
    *(("memory.py", f"{name}.read_text") for name in ("", "file", "groups")),  # the same
    ("systems/engines/lcm/receiver.py", "Image.open"),  # a message; its header is checked before
    ("systems/runs/realism/lamp.py", "trimesh.load"),  # visual meshes that ship
    ("models/paint.py", "path.read_text"),  # makes meshes that ship
    ("report/video.py", "cv2.VideoCapture"),  # the film that was just written
    ("capture/importers/video.py", "cv2.VideoCapture"),  # after `opened`, as a film is decoded from its file only
    *((f"capture/importers/{name}.py", "cv2.imdecode") for name in ("bag", "lcm_log", "lerobot")),  # in a recording
    ("guide/record.py", "given.open"),  # for its SHA-256
}


def dotted(node: ast.expr) -> str:
    """Last two parts of the name of a function; one of them is empty where there is none."""
    if isinstance(node, ast.Attribute):
        return f"{dotted(node.value).rpartition('.')[2]}.{node.attr}"
    return node.id if isinstance(node, ast.Name) else ""


def opens(source: str) -> list[str]:
    """Names of the calls in a module that read a file or parse its contents."""
    found = []
    for node in ast.walk(ast.parse(source)):
        if not isinstance(node, ast.Call):
            continue
        name = dotted(node.func)
        last = name.rpartition(".")[2]
        if last == "open" and name not in ("webbrowser.open", *READERS):
            place = 1 if name == "open" else 0
            modes = [*node.args[place : place + 1], *(one.value for one in node.keywords if one.arg == "mode")]
            read = not modes or not isinstance(modes[0], ast.Constant) or "r" in modes[0].value or "+" in modes[0].value
        else:
            method = last in METHODS and "." in name
            read = name in READERS or name in NAMES or method or (last in NAMES and "." in name)
        if read:
            found.append(name)
    return found


def test_every_reader_goes_through_the_guarded_layer():
    found = {
        (path.relative_to(PACKAGE if folder == PACKAGE else ROOT).as_posix(), name)
        for folder in SOURCES
        for path in folder.rglob("*.py")
        if path.parent != PACKAGE / "reading"
        for name in opens(path.read_text())
    }
    assert found == EXCEPTIONS


@pytest.mark.parametrize(
    "line",
    [
        "np.load(path)",
        "json.loads(text)",
        "path.read_text()",
        "(folder / NAME).read_bytes()",
        "open(path)",
        "open(path, 'rb')",
        "path.open(newline='')",
        "Image.open(path)",
        "cv2.imdecode(content, -1)",
        "trimesh.load_mesh(path)",
        "trimesh.exchange.obj.load_obj(file)",
        "zipfile.ZipFile(path)",
    ],
)
def test_another_way_is_found(line):
    assert opens(line)


@pytest.mark.parametrize("line", ["path.open('w')", "open(path, 'ab')", "webbrowser.open(url)", "read_text(path)"])
def test_writing_is_no_reading(line):
    assert not opens(line)
