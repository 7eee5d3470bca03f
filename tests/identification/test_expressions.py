"""Channels that are formulas in columns: arithmetic with units, and nothing else."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from undertow.errors import UndertowError
from undertow.identification.logs.mapping import Formula, read_mapping
from undertow.identification.logs.reading import read_log

LOG = "t,u,pwm1,cmd 2,east,north\n" + "\n".join(
    f"{0.1 * k},{0.5},{1500 + 40 * k},{10 * k},{3.0},{4.0}" for k in range(6)
)
MAPPING = """
schema = "undertow/mapping/1"
[channels]
f1 = "(pwm1 - 1500) / 400"
f2 = { expression = "max(column('cmd 2') / 100, 0.1) * 2", unit = "lbf" }
wind_speed = { expression = "hypot(east, north)", unit = "knot" }
wind_from = { expression = "atan2(-east, -north)" }
"""


def _read(folder: Path, mapping: str, *channels: str) -> dict[str, np.ndarray]:
    (folder / "log.csv").write_text(LOG + "\n")
    (folder / "log.toml").write_text(mapping)
    return dict(read_log(folder / "log.csv", read_mapping(folder / "log.toml"), channels).channels)


def test_commands_and_wind_from_formulas(tmp_path: Path) -> None:
    read, k = _read(tmp_path, MAPPING, "f1", "f2", "wind_speed", "wind_from"), np.arange(6)
    np.testing.assert_allclose(read["f1"], k / 10)
    np.testing.assert_allclose(read["f2"], 2 * np.maximum(k / 10, 0.1) * 4.4482216152605)
    np.testing.assert_allclose(read["wind_speed"], 5.0 * 1852 / 3600)
    np.testing.assert_allclose(read["wind_from"], np.arctan2(-3.0, -4.0))


@pytest.mark.parametrize(
    ("text", "value"),
    [("-2**2", -4.0), ("1 + 2 * 3 / 4", 2.5), ("clip(a, -1, 1) - sign(a) * pi", 1 - np.pi), ("abs(-a)", 7.0)],
)
def test_formulas_are_ordinary_arithmetic(text: str, value: float) -> None:
    assert Formula(text).of({"a": np.array([7.0])}) == pytest.approx([value])


@pytest.mark.parametrize(
    "text",
    [
        "__import__('os').system('true')",
        "a.real",
        "a[0]",
        "(lambda: 1)()",
        "[a for a in b]",
        "'text'",
        "True",
        "open('x')",
        "a if b else c",
        "sin(a, b)",
        "sin(x=a)",
        "column(a)",
        "a +",
        "a; b",
        "(" * 300 + "a" + ")" * 300,
        "+".join("a" * 150),
        "1j",
    ],
)
def test_nothing_but_arithmetic_is_taken(text: str) -> None:
    with pytest.raises(UndertowError, match=r"formula|function"):
        Formula(text)


@pytest.mark.parametrize(
    ("line", "complaint"),
    [
        (
            'f1 = "2 * /imu/list.data[1]"',
            "not arithmetic (invalid syntax): write numbers, columns (column('its",
        ),
        ('f1 = "pwm9 - 1"', "has no column of expression 'pwm9 - 1', 'pwm9'"),
        ('f1 = "eval(pwm1)"', "function 'eval' is not known"),
        ('f1 = { expression = "pwm1", unit = "parrot" }', "parrot"),
        ('f1 = { expresion = "pwm1" }', "expresion"),
        ('f1 = "pwm1"\n[columns]\npwm1 = "f1"', "'f1' is column 'pwm1' and an expression: keep one"),
    ],
)
def test_mistakes_are_named(tmp_path: Path, line: str, complaint: str) -> None:
    with pytest.raises(UndertowError) as caught:
        _read(tmp_path, f'schema = "undertow/mapping/1"\n[channels]\n{line}\n', "f1")
    assert complaint in str(caught.value)
    assert "\n" not in str(caught.value)
