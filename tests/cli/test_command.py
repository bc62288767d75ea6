# SPDX-License-Identifier: MIT
from pathlib import Path
from typing import Annotated, Literal

import pytest
import typer
import yaml
from typer.testing import CliRunner

import pinwm_drake
from pinwm_drake.cli.command import add_command, completer
from pinwm_drake.errors import InputError, ParameterError
from pinwm_drake.request import BUDGET, LAB, argument, option, request


@request
class Order:
    """Order."""

    twin: Annotated[str, argument("Folder of the twin.", "TWIN", completes="twin")]
    out: Annotated[Path, option("Folder of the results.", "--out", "-o", result="inside")]
    worlds: Annotated[int, option("Number of worlds.", group=BUDGET, ge=1, le=64)] = 8
    yaw: Annotated[float | None, option("Largest turn.", unit="rad", default="the scene's")] = None
    engine: Annotated[Literal["twin", "point"], option("Engine.", group=LAB)] = "twin"
    goal: Annotated[tuple[float, float] | None, option("Goal.", metavar="X Y")] = None
    episodes: Annotated[tuple[str, ...], option("Episodes.", "--episode")] = ()
    shown: Annotated[bool, option("Show it.")] = True
    resume: Annotated[bool, option("Go on.")] = False


@pytest.fixture
def orders():
    """Orders that were run."""
    return []


@pytest.fixture
def run(orders):
    """Runs the command with arguments; returns its exit code and output, or raises what it raised."""
    app = typer.Typer()

    def order(made: Order) -> None:
        """Orders a twin."""
        made.out.mkdir(exist_ok=True)
        orders.append(made)

    add_command(app, Order, order, name="order", example="pinwm order a -o b")
    app.callback()(lambda: None)

    def invoke(*arguments):
        result = CliRunner().invoke(app, ["order", *map(str, arguments)])
        if result.exception is not None and not isinstance(result.exception, SystemExit):
            raise result.exception
        return result.exit_code, result.output

    return invoke


def test_options_make_the_request(run, orders, tmp_path):
    options = ["--worlds", 2, "--goal", 1, 2, "--episode", "a", "--episode", "b", "--no-shown", "--resume"]
    assert run("twin", "-o", tmp_path / "out", *options)[0] == 0
    expected = Order("twin", tmp_path / "out", 2, goal=(1, 2), episodes=("a", "b"), shown=False, resume=True)
    assert orders == [expected]


def test_the_help_has_groups_ranges_units_and_defaults(run):
    code, output = run("--help")
    text = " ".join(output.replace("│", " ").split())
    assert code == 0
    for words in (
        "─ Budget ─",
        "Number of worlds (1 to 64). [default: 8]",
        "--yaw [rad] Largest turn. [default: the scene's]",
        "Engine. One of twin, point. [default: twin]",
        "--shown --no-shown",
        "Example: pinwm order a -o b",
    ):
        assert words in text


def test_a_wrong_value_is_refused(run, orders, tmp_path):
    with pytest.raises(ParameterError, match="--worlds: got 0; allowed: 1 to 64"):
        run("twin", "-o", tmp_path, "--worlds", 0)
    assert orders == []


def test_a_configuration_stands_in_for_defaults(run, orders, tmp_path):
    config = tmp_path / "config.yaml"
    config.write_text(
        f"twin: mine\nout: {tmp_path}/out\nworlds: 3\nyaw: 1e-1\nengine: point\ngoal: [0, 1]\nresume: true\n"
    )
    assert run("--config", config, "--worlds", 5)[0] == 0
    assert orders == [Order("mine", tmp_path / "out", 5, 0.1, "point", (0, 1), resume=True)]


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("worlds: 0", "got worlds = 0; allowed: 1 to 64"),
        ("engine: bullet", 'got engine = "bullet"; allowed: twin, point'),
        ("speed: 1", "got an unknown option 'speed'; allowed: twin, out, worlds"),
        ("command: train", 'got command = "train"; allowed: order'),
        ("- 1", "allowed: a mapping with names of options"),
        ("worlds: [", "row 1: got"),
    ],
)
def test_a_wrong_configuration_names_file_and_option(run, orders, tmp_path, text, message):
    config = tmp_path / "config.yaml"
    config.write_text(text)
    with pytest.raises(InputError) as caught:
        run("twin", "-o", tmp_path, "--config", config)
    assert str(config) in str(caught.value)
    assert message in str(caught.value)
    assert orders == []


def test_the_resolved_configuration_is_beside_the_result_and_makes_the_same_request(run, orders, tmp_path):
    run("twin", "-o", tmp_path / "out", "--worlds", 2, "--goal", 1, 2, "--episode", "a", "--no-shown")
    written = tmp_path / "out/order.config.yaml"
    document = yaml.safe_load(written.read_text())
    assert (document["command"], document["version"]) == ("order", pinwm_drake.__version__)
    assert {"worlds": 2, "yaw": None, "goal": [1.0, 2.0], "episodes": ["a"], "shown": False}.items() <= document.items()
    run("--config", written)
    assert orders[0] == orders[1]


def test_twins_policies_and_scenarios_are_completed(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    for path in ("out/mine/twin.yaml", "out/policy/policy.yaml", "bundle/contract.yaml", "out/near.scenario.yaml"):
        (tmp_path / path).parent.mkdir(parents=True, exist_ok=True)
        (tmp_path / path).write_text("")
    assert completer("twin", ())("out") == ["out/mine"]
    assert {"push_t", "flip_mug"} <= set(completer("scene", ())(""))
    assert completer("scene", ())("out/") == ["out/mine", "out/near.scenario.yaml"]
    assert completer("policy", ())("o") == ["out/policy"]
    assert completer("policy", ())("b") == ["bundle"]
    assert {"push_t", "mpc", "random"} <= set(completer("policy", ())(""))
    assert completer("", ("distil", "ppo"))("d") == ["distil"]
    assert completer("capture", ())("nowhere/") == []
