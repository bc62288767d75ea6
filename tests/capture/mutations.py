# SPDX-License-Identifier: MIT
"""Ways in which the files of a capture get damaged, drawn at random."""

import json
import os
import shutil
from pathlib import Path

import numpy as np
import yaml
from PIL import Image

GARBAGE = [
    None, True, False, 0, -1, 1, 3, 0.5, -0.0, 1e-320, 1e300, -1e300, 1e9, 1e12, 2**63, 10**30, float("nan"),
    float("inf"), -float("inf"), "", " ", "0", "nan", "1e3", "../..", "/", "/etc/passwd", "a\0b", "a\nb", "\ud800",
    "é🦆", "x" * 5000, "sphere", "cylinder", [], {}, [0], [0, 0, 0], [0, 0, 0, 0], [1, 0, 0, 0], [[0]], [None] * 4,
    [float("nan")] * 3, [1e308] * 4, {"p": [0, 0, 0]}, [[1, 0, 0, 0]] * 4, [[1e200] * 4] * 4,
]  # fmt: skip
CELLS = [
    "", " ", "nan", "inf", "-inf", "NaN", "1e400", "1e308", "-1e308", "1e12", "-5", "0", "1", "0.5", "1_0", "0x10", "١",
    "é🦆", "abc", "1,2", '"', '"a""b"', '"a\nb"', "\0", "x" * 200_000, "../../capture.yaml", "rgb", "/dev/null", "=1+1",
]  # fmt: skip
YAML = [
    "a: &a [1]\nb: [*a, *a]", "a: &a [*a]", "? [1, 2]\n: 3", "!!timestamp abc", "!!bool abc", "!!int abc", "- - - -",
    "<<: 3", "schema_version: 0x" + "f" * 5000, "2020-99-99", "!!python/object/apply:os.getpid []", "\x07",
    "--- 1\n--- 2",
    "schema_version: 1\nobject: &a {x: &b [*a, *b]}", "[" * 3000, "{" * 500, "%YAML 9.9\n---\n1", "schema_version: 1",
    "\n".join(f"a{k}: &a{k} [{', '.join([f'*a{k - 1}'] * 9) if k else 1}]" for k in range(30)),
]  # fmt: skip


def mutate(folder: Path, rng: np.random.Generator) -> str:
    """Damages one file or folder of a capture; says how."""
    files = sorted(path for path in folder.rglob("*") if path.is_file())
    # The few tables and documents are hit as often as the many images.
    texts = [path for path in files if path.suffix != ".png"]
    path = pick(rng, texts if rng.random() < 0.7 else files)
    kinds = [*ANY, *BY_SUFFIX.get(path.suffix, []) * 3, *FOLDER]
    kind = kinds[rng.integers(len(kinds))]
    kind(path, rng)
    return f"{kind.__name__} {path.relative_to(folder)}"


def pick(rng, values):
    return values[rng.integers(len(values))]


def write(path, data):
    """Writes a file anew, as the copies share their contents."""
    if path.is_symlink() or path.exists():
        path.unlink()
    path.write_bytes(data)


def delete(path, rng):
    path.unlink()


def truncate(path, rng):
    data = path.read_bytes()
    write(path, data[: rng.integers(len(data) + 1)])


def flip_bytes(path, rng):
    data = bytearray(path.read_bytes())
    for _ in range(rng.integers(1, 20)):
        if data:
            data[rng.integers(len(data))] = rng.integers(256)
    write(path, bytes(data))


def random_bytes(path, rng):
    write(path, rng.bytes(rng.integers(2000)))


def insert_text(path, rng):
    data, text = path.read_bytes(), str(pick(rng, GARBAGE)).encode("utf-8", "surrogatepass")
    at = rng.integers(len(data) + 1)
    write(path, data[:at] + text + data[at:])


def become_folder(path, rng):
    path.unlink()
    path.mkdir()


def become_link(path, rng):
    target = pick(rng, ["/dev/null", "/dev/zero", path.name, "nowhere", "/", *(str(p) for p in path.parent.iterdir())])
    path.unlink()
    path.symlink_to(target)


def become_pipe(path, rng):
    path.unlink()
    os.mkfifo(path)


def become_other(path, rng):
    other = pick(rng, sorted(p for p in path.parent.rglob("*") if p.is_file()))
    write(path, other.read_bytes())


def forbid(path, rng):
    # A copy of its own: the mode belongs to the contents, which others share.
    write(path, path.read_bytes())
    path.chmod(0)


def folder_becomes_file(path, rng):
    shutil.rmtree(path.parent)
    path.parent.write_text("hello")


def folder_vanishes(path, rng):
    shutil.rmtree(path.parent)


def more_episodes(path, rng):
    root = path
    while not (root / "episodes").is_dir():
        if root == root.parent:
            return
        root = root.parent
    name = pick(rng, ["0001", "é🦆", ".hidden", " ", "a\nb", "x" * 200, "[bold]"])
    (root / "episodes" / name).mkdir()


def no_episodes(path, rng):
    for folder in path.parents:
        if (folder / "episodes").is_dir():
            shutil.rmtree(folder / "episodes")
            return


def places(value, found):
    """Every container of a document with each of its keys."""
    for key in list(value) if isinstance(value, dict) else range(len(value)):
        found.append((value, key))
        if isinstance(value[key], (dict, list)):
            places(value[key], found)
    return found


def change_document(path, rng):
    text = path.read_text()
    document = json.loads(text) if path.suffix == ".json" else yaml.safe_load(text)
    for _ in range(rng.integers(1, 3)):
        container, key = pick(rng, places(document, []))
        what = rng.integers(6)
        if what == 0:
            del container[key]
            break
        if what == 1 and isinstance(container, list):
            container.append(container[key])
        elif what == 1:
            container[str(pick(rng, ["extra", "", "é", "k1", "mask_path", "camera_model"]))] = pick(rng, GARBAGE)
        elif what == 2 and isinstance(container[key], (int, float)):
            container[key] = container[key] * float(pick(rng, [-1, 0, 1e-3, 0.9, 1.1, 2, 1000, 1e8]))
        else:
            container[key] = pick(rng, GARBAGE)
    if path.suffix == ".json":
        write(path, json.dumps(document).encode())
    else:
        write(path, yaml.safe_dump(document, sort_keys=False).encode("utf-8", "replace"))


def replace_document(path, rng):
    value = pick(rng, GARBAGE)
    text = pick(rng, YAML) if rng.random() < 0.7 else json.dumps(value)
    write(path, text.encode("utf-8", "surrogatepass"))


def change_cell(path, rng):
    lines = [line.split(",") for line in path.read_text().splitlines()]
    for _ in range(rng.integers(1, 4)):
        row = pick(rng, lines)
        row[rng.integers(len(row))] = pick(rng, CELLS)
    write(path, "\n".join(",".join(row) for row in lines).encode())


def scale_column(path, rng):
    lines = [line.split(",") for line in path.read_text().splitlines()]
    column, factor = rng.integers(len(lines[0])), float(pick(rng, [-1, 0, 0.5, 2, 1000, 1e6, 1e30]))
    for row in lines[1:]:
        try:
            row[column] = repr(float(row[column]) * factor)
        except ValueError:
            return
    write(path, "\n".join(",".join(row) for row in lines).encode())


def change_rows(path, rng):
    lines = path.read_text().splitlines()
    what, k = rng.integers(6), rng.integers(len(lines))
    if what == 0:
        del lines[k]
    elif what == 1:
        lines.insert(k, pick(rng, [lines[k], "", ",", "a,b", lines[0], ",".join(CELLS[:3])]))
    elif what == 2:
        lines[k], lines[-1] = lines[-1], lines[k]
    elif what == 3:
        lines = lines[:1] if rng.random() < 0.5 else lines[:2]
    elif what == 4:
        lines = [line + ",0" for line in lines] if rng.random() < 0.5 else [line.rpartition(",")[0] for line in lines]
    else:
        cells = lines[0].split(",")
        cells[rng.integers(len(cells))] = str(pick(rng, ["t", "px", "", "é", "fx", "frame"]))
        lines[0] = ",".join(cells)
    write(path, pick(rng, ["\n", "\r\n", "\n\n"]).join(lines).encode())


def change_image(path, rng):
    size = (64, 64) if rng.random() < 0.6 else (int(rng.integers(1, 80)), int(rng.integers(1, 80)))
    mode = pick(rng, ["RGBA", "RGB", "L", "LA", "1", "P", "I;16", "I", "CMYK", "F"])
    fill = pick(rng, [0, 1, 255]) if mode != "F" else 0.5
    if mode in ("RGB", "RGBA", "LA", "CMYK"):
        fill = tuple(int(v) for v in rng.integers(0, 256, {"RGB": 3, "RGBA": 4, "LA": 2, "CMYK": 4}[mode]))
    image = Image.new(mode, size, fill)
    path.unlink()
    image.save(path, format="TIFF" if mode in ("F", "I", "CMYK") else "PNG")


def change_mesh(path, rng):
    lines = path.read_text().splitlines()
    what = rng.integers(5)
    if what == 0:
        words = [
            "f 1 2 99",
            "f 0 0 0",
            "f -1 -2 -3",
            "f 1 1 1",
            "v nan 0 0",
            "v 1e300 0 0",
            "f 1/2/3 4 5",
            "v a b c",
            "o",
        ]
        lines.insert(rng.integers(len(lines)), pick(rng, words))
    elif what == 1:
        factor = float(pick(rng, [-1, 0, 1e-6, 1e-3, 0.5, 2, 1000, 1e30]))
        lines = [" ".join([w if w == "v" else repr(float(w) * factor) for w in x.split()]) if x.startswith("v ") else x
                 for x in lines]  # fmt: skip
    elif what == 2:
        lines = [x for x in lines if not (x.startswith("f ") and rng.random() < 0.3)]
    elif what == 3:
        lines = [x for x in lines if not x.startswith(pick(rng, ["v", "f"]))]
    else:
        lines = [x for x in lines if not (x.startswith("v ") and rng.random() < 0.2)]
    write(path, "\n".join(lines).encode())


ANY = [delete, truncate, flip_bytes, random_bytes, insert_text, become_folder, become_link, become_other, forbid]
FOLDER = [folder_becomes_file, folder_vanishes, more_episodes, no_episodes, become_pipe]
BY_SUFFIX = {
    ".json": [change_document, change_document, replace_document],
    ".yaml": [change_document, change_document, replace_document],
    ".csv": [change_cell, change_cell, change_rows, scale_column],
    ".png": [change_image],
    ".obj": [change_mesh],
}
