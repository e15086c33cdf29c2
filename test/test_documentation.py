import re
from pathlib import Path

import pytest
import yaml

from elevator_rectify.ros.documentation import all_parameters, parameter_page, parameter_yaml

ROOT = Path(__file__).parent.parent


def test_parameter_file_is_the_dataclasses() -> None:
    text = (ROOT / "config" / "elevator_rectify.yaml").read_text()
    assert text == parameter_yaml(), (
        "run: python3 -m elevator_rectify.ros.documentation yaml > config/elevator_rectify.yaml"
    )
    loaded = yaml.safe_load(text)["/**/elevator_rectify"]["ros__parameters"]
    assert loaded == {path: default for path, (_, default) in all_parameters().items()}


def test_parameter_page_is_the_dataclasses() -> None:
    assert (ROOT / "docs" / "parameters.md").read_text() == parameter_page(), (
        "run: python3 -m elevator_rectify.ros.documentation page > docs/parameters.md"
    )


def test_pages_link_to_pages_that_exist() -> None:
    for page in (ROOT / "README.md", *sorted((ROOT / "docs").glob("*.md"))):
        for link in re.findall(r"\]\(([^)#:]+)\)", page.read_text()):
            assert (page.parent / link).exists(), f"{page.name} links to {link}"
        for name in re.findall(r"`(\w+\.md)`", page.read_text()):
            assert (ROOT / "docs" / name).exists(), f"{page.name} names {name}"


def test_the_readme_is_short() -> None:
    assert len((ROOT / "README.md").read_text().splitlines()) <= 200


@pytest.mark.parametrize("path", sorted((ROOT / "config").glob("*.yaml")), ids=lambda path: path.stem)
def test_a_cameras_file_names_known_parameters(path: Path) -> None:
    loaded = yaml.safe_load(path.read_text())["/**/elevator_rectify"]["ros__parameters"]
    unknown = {name for name in loaded if name not in all_parameters() and not name.startswith("qos_overrides.")}
    assert not unknown
