from pathlib import Path

import yaml

from elevator_rectify.ros.documentation import all_parameters, parameter_table, parameter_yaml

ROOT = Path(__file__).parent.parent


def test_parameter_file_is_the_dataclasses() -> None:
    text = (ROOT / "config" / "elevator_rectify.yaml").read_text()
    assert text == parameter_yaml(), (
        "run: python3 -m elevator_rectify.ros.documentation yaml > config/elevator_rectify.yaml"
    )
    loaded = yaml.safe_load(text)["/**/elevator_rectify"]["ros__parameters"]
    assert loaded == {path: default for path, (_, default) in all_parameters().items()}


def test_readme_table_is_the_dataclasses() -> None:
    assert parameter_table() in (ROOT / "README.md").read_text(), (
        "run: python3 -m elevator_rectify.ros.documentation table"
    )
