"""How the text of a table is written: lines above its header, delimiters at the ends of its rows."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import polars as pl
import pytest

from undertow.cli.main import main
from undertow.errors import UndertowError
from undertow.identification.logs.chunks import long_logs
from undertow.identification.logs.guess import guess_mapping, guess_table
from undertow.identification.logs.mapping import LogMapping
from undertow.identification.logs.reading import read_log
from undertow.model.loading import load_vehicle

ROWS = 40


def _text(delimiter: str, ends: str = "", newline: str = "\n") -> str:
    rows = [("t", "x", "u")] + [(f"{0.1 * k:.1f}", f"{0.2 * k:.1f}", f"{2 + k % 3}") for k in range(ROWS)]
    first, *others = (delimiter.join(row) for row in rows)
    return newline.join([first, *(row + ends for row in others)]) + newline


@pytest.mark.parametrize("delimiter", [",", ";", "\t"])
@pytest.mark.parametrize(
    "above",
    [
        "# logger 3, boat 7\n# 2 m/s\n",
        "# logger\n\n",
        "% t is in s\n",
        "---- log1Hz_0708 ----\n",
        "Run of Monday\n\n",
        "",
    ],
)
def test_lines_above_the_header_are_no_rows(above: str, delimiter: str, tmp_path: Path) -> None:
    (tmp_path / "log.csv").write_text(above + _text(delimiter))
    guessed = guess_mapping(tmp_path / "log.csv")
    assert {g.channel for g in guessed.columns} == {"x", "u"}
    run = read_log(tmp_path / "log.csv", guessed.meaning)
    np.testing.assert_allclose(run.channels["x"], 0.2 * np.arange(ROWS), atol=1e-12)
    assert (guessed.meaning.comment is None and not guessed.meaning.skip) == (not above)


def test_a_header_may_begin_with_the_sign_of_comments(tmp_path: Path) -> None:
    (tmp_path / "log.csv").write_text("# t,x,u\n0,1,2\n0.1,2,3\n")
    assert {g.channel for g in guess_mapping(tmp_path / "log.csv").columns} == {"x", "u"}


_SETTINGS = {
    "none": "",
    "text": "".join(f"setting {k}: {k / 7:.3f}, or so; see | below\n" for k in range(40)) + "\n",
    "two cells": "vehicle{0}Otter\nrate{0}10\nmass{0}33.5\n",
    "as many cells": "Versuch 3{0}{0}\nDatum{0}1.3.2024{0}\n\nRate{0}10{0}\nStart{0}{0}\n",
    "a number": "12\n",
}


@pytest.mark.parametrize("delimiter", [",", ";", "\t", " "])
@pytest.mark.parametrize("above", _SETTINGS.values(), ids=_SETTINGS)
@pytest.mark.parametrize("units", [False, True])
def test_settings_above_the_header_are_skipped(
    units: bool, above: str, delimiter: str, tmp_path: Path
) -> None:
    """Also where rows begin like one of them, and where a comma is the decimal sign; in parts, too."""
    names, rows = _text(delimiter).split("\n", 1)
    if delimiter != ",":
        rows = rows.replace(".", ",")
    text = above.format(delimiter) + names + "\n" + delimiter.join(["s", "m", "m/s"]) * units + "\n" + rows
    (tmp_path / "log.csv").write_text(text)
    guessed = guess_mapping(tmp_path / "log.csv")
    assert any(asked.startswith("t: ") for asked in guessed.asked) != units
    meaning = guessed.meaning
    assert (meaning.delimiter, meaning.decimal) == (delimiter, "." if delimiter == "," else ",")
    assert meaning.skip == above.count("\n")
    run = read_log(tmp_path / "log.csv", meaning)
    np.testing.assert_allclose(run.channels["x"], 0.2 * np.arange(ROWS), atol=1e-12)
    (long,) = long_logs(tmp_path / "log.csv", meaning)
    parts = [part.run.channels["x"] for part in long.parts(rows=15, overlap=0)]
    np.testing.assert_allclose(np.concatenate(parts), 0.2 * np.arange(ROWS), atol=1e-12)
    assert long.size[1] == 3


@pytest.mark.parametrize("encoding", ["utf-8", "utf-8-sig", "cp1252"])
def test_degree_signs_of_any_encoding_are_units(encoding: str, tmp_path: Path) -> None:
    """As spreadsheets and data loggers save them on Windows; in parts, too."""
    rows = "".join(f"{0.1 * k:.1f};{0.2 * k:.1f};{k}\n" for k in range(ROWS))
    path = tmp_path / "log.csv"
    path.write_text("Größe: 3 µm\nt;x;Heading [°]\n" + rows, encoding=encoding)
    meaning = guess_mapping(path).meaning
    assert meaning.columns["Heading [°]"].unit == "deg"
    run = read_log(path, meaning)
    np.testing.assert_allclose(run.channels["psi"], np.radians(np.arange(ROWS)))
    (long,) = long_logs(path, meaning)
    parts = [part.run.channels["psi"] for part in long.parts(rows=15, overlap=0)]
    np.testing.assert_allclose(np.concatenate(parts), run.channels["psi"])


@pytest.mark.parametrize("unit", ["1/min", "rpm", "%"])
@pytest.mark.parametrize("below", [False, True])
def test_units_of_commands_are_those_that_the_log_states(below: bool, unit: str, tmp_path: Path) -> None:
    """In the name, where its number is not that of the motor, or in a line below, which misses no command."""
    names = ["t [s]", "heading [deg]", *(f"n{k}" if below else f"n{k} [{unit}]" for k in (1, 2))]
    units = "s,deg," + ",".join([unit, unit]) + "\n"
    rows = "".join(f"{0.1 * k:.1f},{k},{50 + k % 7},{60 - k % 5}\n" for k in range(ROWS))
    (tmp_path / "log.csv").write_text(",".join(names) + "\n" + units * below + rows)
    guessed = guess_mapping(tmp_path / "log.csv", load_vehicle("otter"))
    assert [g.channel for g in guessed.columns] == ["psi", "port", "starboard"]
    assert not any("previous value" in asked for asked in guessed.asked)
    stated = "per cent, but the vehicle file expects N" if unit == "%" else "1 rpm give?"
    assert all(stated in g.doubt for g in guessed.columns[1:])


@pytest.mark.parametrize("above", ["", "# run 3 of boat 7\n"])
def test_names_behind_the_sign_of_comments_are_a_header(above: str, tmp_path: Path) -> None:
    """As numpy.savetxt writes them, with blanks between numbers."""
    (tmp_path / "log.txt").write_text(f"{above}# {_text(' ')}")
    meaning = guess_mapping(tmp_path / "log.txt").meaning
    run = read_log(tmp_path / "log.txt", meaning)
    np.testing.assert_allclose(run.channels["x"], 0.2 * np.arange(ROWS), atol=1e-12)
    (long,) = long_logs(tmp_path / "log.txt", meaning)
    parts = [part.run.channels["u"] for part in long.parts(rows=15, overlap=0)]
    np.testing.assert_allclose(np.concatenate(parts), run.channels["u"])


def test_rows_below_settings_without_names_are_refused_as_that(tmp_path: Path) -> None:
    rows = "".join(f"{0.1 * k:.1f}\t{k}\n" for k in range(ROWS))
    (tmp_path / "log.tsv").write_text("FRAMES\t40\nBODY\tROV\t1\n" + rows)
    with pytest.raises(UndertowError, match=r"numbers in line 3 .* names of its 2 columns right above it"):
        guess_mapping(tmp_path / "log.tsv")


def test_quoted_numbers_may_have_decimal_commas_between_commas(tmp_path: Path) -> None:
    rows = "".join(
        f'"{0.1 * k:.1f}";"{0.2 * k:.1f}"\n'.replace(".", ",").replace(";", ",") for k in range(ROWS)
    )
    (tmp_path / "log.csv").write_text('"t [s]","x [m]"\n' + rows)
    run = read_log(tmp_path / "log.csv", guess_mapping(tmp_path / "log.csv").meaning)
    np.testing.assert_allclose(run.channels["x"], 0.2 * np.arange(ROWS), atol=1e-12)


def test_where_a_line_is_too_long_is_counted_from_the_top(tmp_path: Path) -> None:
    (tmp_path / "log.csv").write_text("one\ntwo\nt,x,u\n0,1,2\n0.1,2,3,4,5\n")
    with pytest.raises(UndertowError, match=r"line 5 has 5 cells, the header 3: .* skip"):
        read_log(tmp_path / "log.csv", LogMapping(skip=2))
    with pytest.raises(UndertowError, match="no header"):
        read_log(tmp_path / "log.csv", LogMapping(skip=20))


@pytest.mark.parametrize("delimiter", [",", ";", "\t"])
@pytest.mark.parametrize("newline", ["\n", "\r\n"])
def test_rows_may_end_with_a_delimiter(delimiter: str, newline: str, tmp_path: Path) -> None:
    (tmp_path / "log.csv").write_text(_text(delimiter, delimiter, newline), newline="")
    run = read_log(tmp_path / "log.csv", LogMapping(delimiter=delimiter))
    np.testing.assert_allclose(run.channels["u"], 2.0 + np.arange(ROWS) % 3)
    assert run.channels.keys() == {"x", "u"}


def test_a_cell_without_a_name_at_the_end_of_a_row_is_refused(tmp_path: Path) -> None:
    (tmp_path / "log.csv").write_text("t,x,u\n0,1,2,\n0.1,2,3,4\n")
    with pytest.raises(UndertowError, match="line 3 has 4 cells, the header 3"):
        read_log(tmp_path / "log.csv")


@pytest.mark.parametrize("minutes", [False, True])
@pytest.mark.parametrize(("latitude", "longitude"), [(-33.5, -70.6), (63.4, 10.4), (-33.9, 151.2)])
def test_the_letter_of_a_hemisphere_is_a_sign(
    latitude: float, longitude: float, minutes: bool, tmp_path: Path
) -> None:
    """A vehicle that goes north and east does so in all of them; beside that, N, S and W are units."""

    def cell(degrees: float, letters: str) -> str:
        size = abs(degrees)
        number = 100 * np.floor(size) + 60 * (size % 1) if minutes else size
        return f"{number:.7f} {letters[int(degrees < 0)]}"

    t = np.arange(0.0, 60.0, 0.5)
    north = latitude + t / 111_000
    east = longitude + 2 * t / (111_000 * np.cos(np.radians(latitude)))
    columns = {
        "t": t,
        "heading": np.degrees(np.arctan2(2, 1)) + np.sin(t),
        "Latitude": [cell(value, "NS") for value in north],
        "Longitude": [cell(value, "EW") for value in east],
        "thrust": [f"{abs(value):.2f} N" for value in np.sin(t)],
    }
    pl.DataFrame(columns).write_csv(tmp_path / "log.csv")
    guessed = guess_mapping(tmp_path / "log.csv")
    run = read_log(tmp_path / "log.csv", guessed.meaning)
    np.testing.assert_allclose(run.channels["x"], t, rtol=0.01, atol=0.05)
    np.testing.assert_allclose(run.channels["y"], 2 * t, rtol=0.01, atol=0.05)
    (thrust,) = (g for g in guessed.columns if g.channel == "thrust")
    assert thrust.entry["unit"] == "N"


def _with_quaternions(**columns: np.ndarray) -> pl.DataFrame:
    """A vehicle that turns by 0.02 rad/s at 1 m/s; each quaternion is of the heading that is given."""
    t = np.arange(0.0, 60.0, 0.1)
    table = {"t": t}
    for name, psi in columns.items():
        half = psi / 2
        parts = np.cos(half), 0.0 * t, 0.0 * t, np.sin(half)
        table |= {f"{name}{letter}": part for letter, part in zip("wxyz", parts, strict=True)}
    return pl.DataFrame(table)


def test_the_attitude_is_measured_and_of_the_message_with_the_position() -> None:
    """A goal is no attitude; a compass of other axes comes after the estimate that the position is of."""
    t = np.arange(0.0, 60.0, 0.1)
    psi = 0.02 * t
    quaternions = {"goal.pose.orientation.": 0.7 + 0.1 * np.sin(t), "imu.orientation.": np.pi / 2 - psi}
    table = _with_quaternions(**quaternions, **{"nav.pose.orientation.": psi}).with_columns(
        pl.Series("nav.pose.position.x", np.sin(psi) / 0.02),
        pl.Series("nav.pose.position.y", (1 - np.cos(psi)) / 0.02),
    )
    guessed = guess_table(table, Path("log.csv"))
    (heading,) = (g for g in guessed.columns if g.channel == "psi")
    assert heading.column.startswith("nav.pose.orientation.w")
    only_goal = guess_table(_with_quaternions(**{"goal.orientation.": psi}), Path("log.csv"))
    assert not only_goal.columns


def test_parts_of_a_quaternion_are_neither_motions_nor_flags() -> None:
    """`quat_w` and `quat_z` are no heave and no depth, and x and y of a level vehicle flag no sensor."""
    psi = 0.02 * np.arange(0.0, 60.0, 0.1)
    guessed = guess_table(_with_quaternions(quat_=psi), Path("log.csv"))
    assert {g.channel for g in guessed.columns} == {"phi", "theta", "psi"}
    assert not any("flag" in question for question in guessed.asked)


@pytest.mark.parametrize("name", ["As{}_filt", "{}", "pos_{}"])
def test_a_letter_beside_unknown_words_is_asked_about_as_a_position(name: str) -> None:
    """`AsX_filt` may be an angular speed, and not only its unit is in question."""
    t = np.arange(0.0, 60.0, 0.1)
    columns = {"t": t, name.format("X"): np.sin(t / 3), name.format("Y"): np.cos(t / 3)}
    said = " ".join(guess_table(pl.DataFrame(columns), Path("log.csv")).asked)
    assert ("is it the position x, in m?" in said) == ("As" in name)
    assert ("is it in m?" in said) == ("As" not in name)


def test_a_command_to_copy_has_quotes_and_asks_only_for_questions(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    Path("dive of May.csv").write_text(_text(","))
    assert main(["map", "new", "dive of May.csv"]) == 0
    assert "undertow doctor VEHICLE 'dive of May.csv' --map log.toml" in capsys.readouterr().out


def test_a_folder_beside_a_file_is_refused_as_a_folder(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    (tmp_path / "nav").mkdir()
    for file in ("nav/pose.csv", "motors.csv"):
        (tmp_path / file).write_text(_text(","))
    assert main(["map", "new", str(tmp_path / "nav"), str(tmp_path / "motors.csv")]) == 2
    assert "beside other logs only files can be given" in " ".join(capsys.readouterr().err.split())


@pytest.mark.parametrize("title", ["", 'TITLE = "zigzag 20/20"\n'])
@pytest.mark.parametrize("zone", ["", "ZONE T = run1, I = 60\n"])
def test_the_names_of_a_tecplot_file_are_those_of_its_columns(title: str, zone: str, tmp_path: Path) -> None:
    """In quotes behind "Variables =", above columns that stand below each other."""
    t = 0.1 * np.arange(60)
    rows = [f"  {a:.6E}  {np.sin(a):.6E} {2 * np.sin(a):.6E}" for a in t]
    names = ' Variables = "t (s)" "Surge speed (m/s)",\n"Yaw rate (deg/s)"\n'
    (tmp_path / "log.out").write_text(title + names + zone + "\n".join(rows) + "\n")
    guessed = guess_mapping(tmp_path / "log.out")
    run = read_log(tmp_path / "log.out", guessed.meaning)
    np.testing.assert_allclose(run.t, t, atol=1e-9)
    np.testing.assert_allclose(run.channels["u"], np.sin(t), atol=1e-6)
    np.testing.assert_allclose(run.channels["r"], np.radians(2 * np.sin(t)), atol=1e-6)


def test_names_of_several_words_above_columns_between_blanks_are_refused(tmp_path: Path) -> None:
    (tmp_path / "log.txt").write_text("time (s) x (m)\n" + "".join(f"{k} {k}.5\n" for k in range(30)))
    with pytest.raises(UndertowError, match=r"4 names \(time \(s\) x \(m\)\), but 2 cells .* double quotes"):
        guess_mapping(tmp_path / "log.txt")


def test_lines_that_end_with_several_carriage_returns_are_lines(tmp_path: Path) -> None:
    text = "t\tx\tu\r\r\r\n" + "".join(f"{0.1 * k:.1f}\t{k}\t{k % 3}\t\r\r\r\n" for k in range(30))
    (tmp_path / "log.txt").write_bytes(text.encode())
    run = read_log(tmp_path / "log.txt", LogMapping(delimiter="\t"))
    np.testing.assert_allclose(run.channels["u"], np.arange(30) % 3)


def test_a_quote_in_the_header_that_does_not_end_is_refused(tmp_path: Path) -> None:
    (tmp_path / "log.csv").write_bytes(b'""\0",')
    with pytest.raises(UndertowError, match="a header with a quote that does not end"):
        read_log(tmp_path / "log.csv")


def test_a_first_row_with_a_text_of_two_lines_is_no_header(tmp_path: Path) -> None:
    rows = [f'{1528161762.9 + k:.2f},-121.{748 + k},38.53,{k}.5,"not reached\n"\n' for k in range(30)]
    (tmp_path / "log.csv").write_text("".join(rows))
    with pytest.raises(UndertowError, match="begins with numbers"):
        guess_mapping(tmp_path / "log.csv")
