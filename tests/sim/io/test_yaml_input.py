"""YAML that people write: every slip is named by file, line and field."""

import re
from pathlib import Path

import pytest
from pydantic import BaseModel, ConfigDict

from litsim_sim.core.errors import InputError
from litsim_sim.io.yaml_input import SHOWN, TEXT_MAX, load_yaml, parse_yaml, read_yaml, validate_yaml


class Wheel(BaseModel):
    model_config = ConfigDict(extra="forbid")

    radius: float


class Car(BaseModel):
    model_config = ConfigDict(extra="forbid")

    name: str
    wheels: list[Wheel] = []
    doors: int = 4
    engine: int | list[int] | Wheel = 1


def refusal(path: Path, text: str) -> str:
    path.write_text(text, encoding="utf-8")
    with pytest.raises(InputError) as caught:
        read_yaml(path, Car)
    message = str(caught.value)
    assert message.startswith(f"{path}: ") and "\n" not in message
    return message.removeprefix(f"{path}: ")


def test_a_sound_file(tmp_path: Path) -> None:
    path = tmp_path / "car.yaml"
    path.write_text("name: Ä\nwheels:\n  - {radius: 0.3}\n", encoding="utf-8")
    assert read_yaml(path, Car) == Car(name="Ä", wheels=[Wheel(radius=0.3)])


def test_files_that_cannot_be_read(tmp_path: Path) -> None:
    with pytest.raises(InputError, match=r"none\.yaml: no such file"):
        read_yaml(tmp_path / "none.yaml", Car)
    with pytest.raises(InputError, match="is a folder, expected a file"):
        read_yaml(tmp_path, Car)
    (tmp_path / "binary.yaml").write_bytes(b"\xff\xfe\x00")
    with pytest.raises(InputError, match=r"binary\.yaml: cannot be read as UTF-8 text"):
        read_yaml(tmp_path / "binary.yaml", Car)


def test_what_is_too_large_is_not_read(tmp_path: Path) -> None:
    large = tmp_path / "large.yaml"
    with large.open("wb") as file:
        file.truncate(TEXT_MAX + 1)
    with pytest.raises(InputError, match=f"has {TEXT_MAX + 1} bytes, expected at most {TEXT_MAX}"):
        read_yaml(large, Car)


def test_a_huge_value_is_shown_in_short(tmp_path: Path) -> None:
    assert len(refusal(tmp_path / "car.yaml", f"name: a\ndoors: {'x' * 100_000}\n")) < 300
    assert len(refusal(tmp_path / "car.yaml", "[" + "[1, 2]," * 1_000 + "]")) < 300


@pytest.mark.parametrize(
    ("text", "message"),
    [
        (
            "name: a\nengine: big\n",
            "line 2, field engine: Input should be a valid integer.*; line 2, field engine: Input should be a .*list",
        ),
        ("name: a\nengine: [1, x]\n", "line 2, field engine.1: Input should be a valid integer.*, found 'x'"),
        ("name: a\nengine: {radius: x}\n", "line 2, field engine.radius: Input should be a valid number.*, found 'x'"),
        ("name: a\nwheels: [\n", "malformed YAML: .*line 3"),
        ("", "expected fields such as name, wheels, doors, engine, found None$"),
        ("- name\n", r"expected fields such as name, wheels, doors, engine, found \['name'\]$"),
        ("name: a\ndoors: many\n", "line 2, field doors: Input should be a valid integer.*, found 'many'$"),
        ("name: a\ndors: 3\n", "line 2, field dors: Extra inputs .*; known fields: name, wheels, doors, engine$"),
        ("doors: 3\n", "field name: Field required; known fields: name, wheels, doors, engine$"),
        (
            "name: a\nwheels:\n  - radius: 1\n  - radius: x\n",
            r"line 4, field wheels\.1\.radius: Input should be a valid number.*, found 'x'$",
        ),
        ("name: a\nwheels:\n  - radius: 1\n  - {}\n", r"line 4, field wheels\.1\.radius: Field required$"),
        ("name: a\ndoors: 2\ndoors: 4\n", "^malformed YAML: key 'doors' occurs twice, line 3, "),
        ("name: a\nwheels:\n  - {radius: 1, radius: 2}\n", "key 'radius' occurs twice, line 3, "),
        ("name: " + "[" * 3000 + "]" * 3000, "^malformed YAML: nested deeper than 50 levels, line 1, "),
        ("name: " + "{a: " * 3000 + "}" * 3000, "nested deeper than 50 levels"),
        (
            "name: a\ndoors: 2020-13-45\n",
            "^malformed YAML: !!timestamp has no value '2020-13-45': month must be in 1..12, line 2",
        ),
        ("name: [1]\ndoors: x\n", "^line 1, field name: Input should be a valid string; line 2, field doors: "),
    ],
)
def test_slips(tmp_path: Path, text: str, message: str) -> None:
    said = refusal(tmp_path / "car.yaml", text)
    assert re.search(message, said), said


def test_merged_fields_may_be_overridden(tmp_path: Path) -> None:
    path = tmp_path / "car.yaml"
    path.write_text("name: a\nwheels:\n  - &usual {radius: 0.3}\n  - {<<: *usual, radius: 0.4}\n")
    assert [wheel.radius for wheel in read_yaml(path, Car).wheels] == [0.3, 0.4]


def test_names_of_lanes_are_no_numbers() -> None:
    said = load_yaml("[101_0, 1_0.5, 120, -3, 0.5, 1.0e-3, .inf, 0x1f]", "here")
    assert said == ["101_0", "1_0.5", 120, -3, 0.5, 1e-3, float("inf"), 31]


def test_many_slips_are_counted(tmp_path: Path) -> None:
    said = refusal(tmp_path / "car.yaml", "name: a\n" + "".join(f"x{i}: 1\n" for i in range(SHOWN + 2)))
    assert said.count("field x") == SHOWN
    assert "; and 2 more; known fields" in said


def test_values_that_were_changed_since(tmp_path: Path) -> None:
    with pytest.raises(InputError, match=r"^here: field doors: Input should be a valid integer.*, found 'x'$"):
        validate_yaml({"name": "a", "doors": "x"}, Car, "here", "name: a\n")


def test_bytes_of_an_attachment() -> None:
    assert parse_yaml("name: Ä".encode(), "here", Car) == {"name": "Ä"}
    with pytest.raises(InputError, match=r"^here: malformed YAML: .*invalid"):
        parse_yaml(b"name: \xff", "here", Car)
