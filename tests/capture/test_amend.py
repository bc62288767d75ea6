# SPDX-License-Identifier: MIT
import pytest
import yaml

from pinwm_drake.capture.amend import amend
from pinwm_drake.errors import InputError

POSE = {"p": [1.0, 2.0, 3.0], "q": [1.0, 0.0, 0.0, 0.0]}
BLOCK = """\
# head
object: # the object
    name: a # its name
    X_WO:
      p: [0, 0, 0] # by hand
      q:
      - 1
      - 0
      - 0
      - 0 # end
    # after
    mesh: b
floor: {height: 0.0} # table
"""


def put(path, text):
    path.write_text(text, newline="")
    return amend(path, {("object", "X_WO"): POSE})


@pytest.mark.parametrize(
    "text",
    [
        "# a comment alone\n",
        "object: {name: a, mesh: b} # x\n",
        "object: {name: a, } # q\n",
        "object:\n  name: a # the name\n  # c\n  mesh: b\n# floor\nfloor: {height: 0.0}\n",
        BLOCK,
        "object: {} # none\n",
        "object:\nfloor: {height: 1}  # hm\n",
        "object: null # none\nx: 1",
        "a: 1 # one",
        "{a: 1} # one",
        "object: {name: a, X_WO: {p: [1, 2, 3], q: [1, 0, 0, 0]}} # hm\n",
        "object:\n  name: |\n    long # no comment\n    text\n",
        "---\nobject:\n  name: x # k\n...\n",
        "object:\r\n  name: a # x\r\n  mesh: b\r\n",
    ],
)
def test_a_value_is_put_in_and_comments_stay(tmp_path, text):
    path = tmp_path / "a.yaml"
    before = yaml.safe_load(text) or {}
    for _ in range(2):
        assert put(path, text) == []
        after = yaml.safe_load(path.read_text())
        assert after == {**before, "object": {**(before.get("object") or {}), "X_WO": POSE}}
        comments = [line.partition("#")[2] for line in text.splitlines() if "#" in line]
        assert [line.partition("#")[2] for line in path.read_text().splitlines() if "#" in line] == comments
        text = path.read_text()


@pytest.mark.parametrize(
    "text",
    [
        "&b\nobject: &c {name: a}\nother: *c # bad\n",
        "&b\nobject: &c {name: 'a # b'}\nother: *c # bad\n",
        "object:\n  X_WO: # lost\n    p: 1\n",
        "object:\n  X_WO: | # lost\n    p\n",
    ],
)
def test_comments_that_go_are_told(tmp_path, text):
    assert put(tmp_path / "a.yaml", text) == ["doubtful: comments of a.yaml are gone"]
    assert yaml.safe_load((tmp_path / "a.yaml").read_text())["object"]["X_WO"] == POSE


@pytest.mark.parametrize("name", ["'a # b'", "a#b"])
def test_a_hash_within_a_text_is_no_comment(tmp_path, name):
    path = tmp_path / "a.yaml"
    path.write_text(f"object:\n  name: {name}\n  mesh: b # mine\n")
    assert amend(path, {("object", "name"): "c"}) == []
    assert path.read_text() == "object:\n  name: c\n  mesh: b # mine\n"


def test_a_file_is_made_and_no_mapping_is_refused(tmp_path):
    assert not amend(tmp_path / "a.yaml", {("b",): 1, ("object", "X_WO"): POSE})
    assert yaml.safe_load((tmp_path / "a.yaml").read_text()) == {"b": 1, "object": {"X_WO": POSE}}
    for text in ("- 1", "object: 3"):
        with pytest.raises(InputError, match="a mapping with keys"):
            put(tmp_path / "a.yaml", text)
        assert (tmp_path / "a.yaml").read_text() == text
