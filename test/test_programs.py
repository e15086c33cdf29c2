"""The programs' common door: names, missing packages, wrong arguments."""

from __future__ import annotations

import ast
import builtins
import errno
import importlib
import sys
from pathlib import Path
from typing import Any

import pytest

from elevator_rectify import programs
from elevator_rectify.core import Config, ScaleConfig
from elevator_rectify.share import share_file

ROOT = Path(__file__).parent.parent


def test_setup_installs_every_program() -> None:
    tree = ast.parse((ROOT / "setup.py").read_text())
    (names,) = [
        node.value.func.value.value.split()  # type: ignore[attr-defined]
        for node in ast.walk(tree)
        if isinstance(node, ast.Assign) and getattr(node.targets[0], "id", "") == "PROGRAMS"
    ]
    assert names and set(names) == set(programs.PROGRAMS)
    assert all(callable(getattr(programs, name)) for name in names)


def test_a_missing_package_is_said_with_its_remedy(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    real = builtins.__import__

    def without(name: str, *args: Any, **options: Any) -> Any:
        if name.partition(".")[0] == "rosbags":
            raise ModuleNotFoundError(f"No module named {name!r}", name=name)
        return real(name, *args, **options)

    monkeypatch.setattr(builtins, "__import__", without)
    for name in [
        name for name in sys.modules if name.startswith(("elevator_rectify.recordings", "elevator_rectify.ros.bag"))
    ]:
        monkeypatch.delitem(sys.modules, name)
    assert programs.run("replay", ["replay", "bag"]) == 3
    assert "pip install rosbags" in capsys.readouterr().err


def test_the_node_needs_no_rosbags() -> None:
    for path in (ROOT / "elevator_rectify" / "ros").glob("*.py"):
        if path.stem != "bag":
            assert "rosbags.highlevel" not in path.read_text() and "import rosbags" not in path.read_text(), path
            assert "elevator_rectify.ros.bag" not in path.read_text(), path


@pytest.mark.parametrize(
    ("arguments", "said"),
    [
        (["replay", "--set", "nonsense=1", "bag"], "there is no parameter 'nonsense'"),
        (["replay", "--set", "measurement.edges=perhaps", "bag"], "must be true or false"),
        (["replay", "--set", "scale.column_pitch_m=wide", "bag"], "must be float"),
        (["replay", "--set", "panel.file=/nowhere.yaml", "bag"], "panel file /nowhere.yaml cannot be read"),
        (["teach", "/nowhere.png"], "is no picture that OpenCV reads"),
        (["calibrate_camera", "/nowhere.png"], "is no picture that OpenCV reads"),
        (["play", "--rate", "0", "bag"], "not above 0"),
        (["latency", "--size", "640"], "WIDTHxHEIGHT"),
        (["benchmark", "--levels", "heroic"], "there is no level heroic"),
        (["benchmark", "--compare", "nowhere.json"], "holds no figures"),
        (["render", "--views", "0", "bag"], "not 1 or more"),
    ],
)
def test_a_wrong_value_is_one_line_and_not_a_traceback(
    arguments: list[str], said: str, capsys: pytest.CaptureFixture[str]
) -> None:
    try:
        code = programs.run(arguments[0], arguments)
    except SystemExit as end:
        code = int(end.code or 0)
    assert code == 2 and said in capsys.readouterr().err


def test_a_bare_number_for_a_configuration_is_a_clear_error() -> None:
    with pytest.raises(ValueError, match=r"Config\.scale must be a ScaleConfig, not 0\.045"):
        Config(scale=0.045)  # type: ignore[arg-type]
    assert Config(scale=ScaleConfig(column_pitch_m=0.045)).scale.column_pitch_m == 0.045


def test_shared_files_are_found_and_missing_ones_named() -> None:
    assert (share_file("bags/paper_5x5") / "metadata.yaml").exists()
    with pytest.raises(FileNotFoundError, match=r"nothing\.yaml is in none of"):
        share_file("config/nothing.yaml")


def test_a_full_disk_is_said_in_one_line(monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]) -> None:
    full = OSError(errno.ENOSPC, "No space left on device", "/out/panels.txt")

    def replay(arguments: list[str]) -> int:
        raise full if arguments else OSError(errno.EINVAL, "a defect")

    # The test of a missing package leaves the packages without their modules as attributes.
    monkeypatch.setattr(importlib.import_module("elevator_rectify.recordings.replay"), "main", replay)
    assert programs.run("replay", ["replay", "bag"]) == 1
    said = capsys.readouterr().err
    assert said.count("\n") == 1 and "/out/panels.txt: No space left" in said
    with pytest.raises(OSError, match="defect"):
        programs.run("replay", ["replay"])
