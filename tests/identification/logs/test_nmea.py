"""Sentences of NMEA 0183 as a log: places, headings, rudders, and the times of sentences without one."""

from __future__ import annotations

from functools import reduce
from operator import xor
from pathlib import Path

import numpy as np
import pytest

from undertow.errors import UndertowError
from undertow.identification.logs.formats.fieldlog import read_field_log
from undertow.identification.logs.reading import read_log


def _line(text: str) -> str:
    return f"${text}*{reduce(xor, text.encode()):02X}"


def _clock(t: float) -> str:
    t %= 86_400.0
    return f"{int(t // 3600):02}{int(t // 60 % 60):02}{t % 60:05.2f}"


def _angle(degrees: float, digits: int) -> str:
    return f"{int(abs(degrees)):0{digits}}{60 * (abs(degrees) % 1):08.5f}"


def _voyage(begin: float) -> list[str]:
    """A boat off Cape Horn that goes south at 2 m/s: a fix a second, ten headings, rudder and shaft."""
    lines = []
    for k in range(30):
        lat, clock = 55.9 + 2.0 * k / 111_330, _clock(begin + k)
        lines.append(_line(f"GPRMC,{clock},A,{_angle(lat, 2)},S,{_angle(67.3, 3)},W,3.888,180.0,010124,,,A"))
        lines += [_line(f"HEHDT,{170.0 + k + 0.1 * j:.1f},T") for j in range(10)]
        lines += [_line(f"IIRSA,{5.0 + 0.1 * k:.1f},A,,"), _line(f"IIRPM,S,1,{600 + k}.0,,A")]
        lines += [_line(f"IIVWR,{j:03},R,05.8,N,,,,") for j in range(20)]  # which nothing reads
        lines.append("!AIVDM,1,1,,A,15M67FC000G?ufbE`FepT@3n00Sa,0*5C")
    return lines


@pytest.mark.parametrize("begin", [30_000.0, 86_390.0])
def test_sentences_are_the_motion_and_commands_of_a_ship(begin: float, tmp_path: Path) -> None:
    (tmp_path / "day.txt").write_text("\n".join([*_voyage(begin), "$GPRMC,235959.00,A,55"]))
    log = read_field_log(tmp_path / "day.txt")
    assert log.format == "NMEA 0183"
    assert log.notes == ("sentences that are cut off or have a wrong checksum left out: 1",)
    run = read_log(tmp_path / "day.txt", channels=["propeller", "rudder"])
    south = -run.reports("x")
    there = np.isfinite(south)
    np.testing.assert_allclose(south[there], 2.0 * run.t[there], atol=0.1)
    np.testing.assert_allclose(run.reports("y")[there], 0.0, atol=0.1)
    heading = np.degrees(run.reports("psi"))
    np.testing.assert_allclose(heading, 170.0 + run.t, atol=1e-6, equal_nan=True)
    assert np.isfinite(heading).all()
    assert run.channels["rudder"][0] == pytest.approx(np.radians(5.0))
    assert run.channels["propeller"][0] == pytest.approx(600 * 2 * np.pi / 60)


@pytest.mark.parametrize(("variation", "added"), [("3.0,W", -3.0), (",", 0.0)])
def test_times_that_a_logger_wrote_before_each_sentence_come_first(
    variation: str, added: float, tmp_path: Path
) -> None:
    """The variation is added to a magnetic heading, or asked for."""
    lines = [f"2023-09-02T12:41:{k:02}.250+00:00\t{_line(f'IIHDG,{k}.0,,,{variation}')}" for k in range(20)]
    (tmp_path / "sail.nmea").write_text("\n".join(lines) + "\n")
    log = read_field_log(tmp_path / "sail.nmea")
    run = read_log(tmp_path / "sail.nmea")
    np.testing.assert_allclose(run.t, np.arange(20.0))
    np.testing.assert_allclose(np.degrees(run.channels["psi"]), added + np.arange(20.0))
    assert any("magnetic" in remark for remark in log.remarks) == (added == 0.0)


def test_sentences_in_the_messages_of_a_program_have_its_times(tmp_path: Path) -> None:
    """Its first lines are no sentences; each of the others has a time, and what wrote it."""
    lines = [f"2024-05-01 12:00:00.{k}00 | INFO | main:1 - waiting for a receiver" for k in range(5)]
    for k in range(30):
        lines.append(f"2024-05-01 12:00:{k:02}.250 | DEBUG | main:9 - {_line(f'HEHDT,{170.0 + k:.1f},T')}")
    (tmp_path / "run.txt").write_text("\n".join(lines))
    log = read_field_log(tmp_path / "run.txt")
    assert log.format == "NMEA 0183"
    run = read_log(tmp_path / "run.txt")
    np.testing.assert_allclose(run.t, np.arange(30.0), atol=1e-6)
    np.testing.assert_allclose(np.degrees(run.channels["psi"]), 170.0 + np.arange(30.0), atol=1e-6)


@pytest.mark.parametrize(
    ("text", "words"),
    [
        ("HEHDT,10.0,T", "has no sentence with a time"),
        ("GPRMC,120000.00,V,,,,,,,010124,,,N", "has no NMEA sentence with a motion"),
    ],
)
def test_sentences_without_a_time_or_a_motion_are_refused(text: str, words: str, tmp_path: Path) -> None:
    (tmp_path / "day.txt").write_text("\n".join([_line(text)] * 9))
    with pytest.raises(UndertowError, match=words):
        read_log(tmp_path / "day.txt")
