"""The paper's tables: every digit as printed, and every defect found."""

from __future__ import annotations

import re
from dataclasses import replace
from pathlib import Path

import pytest

from undertow.paper.tables import KINDS, Appendix, Remark, appendix, audit

PAPER = Path(__file__).parents[3] / "shared" / "paper.txt"
_SYMBOLS = {
    "m_x": "m_x",
    "m_z": "m_z",
    "X_u": "X_u",
    "X_{u u }": "X_uabsu",
    "Z_w": "Z_w",
    "Z_g": "Z_g",
    "N_r": "N_r",
}


@pytest.fixture(scope="module")
def tables() -> Appendix:
    return appendix()


@pytest.fixture(scope="module")
def remarks(tables: Appendix) -> list[Remark]:
    return audit(tables)


def _quantity(label: str) -> str:
    label = label.replace("$", "").replace("\\mathbf", "").strip()
    if label == "Variance":
        return "variance"
    bare = label.removeprefix("Stnd Dev").strip()
    prefix = "sd_" if bare != label else ""
    bare = bare.split("(")[0].strip()
    return prefix + _SYMBOLS.get(bare, {"Nr": "N_r"}.get(bare, "I_zz"))


def _printed() -> list[dict[str, dict[str, str]]]:
    """Tables of the appendix out of the paper's text: quantity -> case -> digits."""
    found: list[dict[str, dict[str, str]]] = []
    cases: list[str] = []
    lines = PAPER.read_text(encoding="utf-8").splitlines()
    start = next(i for i, line in enumerate(lines) if "Appendix A provides the statistical data" in line)
    for line in lines[start:]:
        cells = [cell.strip() for cell in line.strip().strip("|").split("|")] if line.startswith("|") else []
        if cells and cells[0] == "Case":
            cases = [cell for cell in cells[1:] if cell]
            if cases[0] == "1":
                found.append({})
        elif cells and not set(line) <= set("|- "):
            row = found[-1].setdefault(_quantity(cells[0]), {})
            row.update(zip(cases, cells[1:], strict=False))
    return found


@pytest.mark.skipif(not PAPER.is_file(), reason=f"the paper's text is not there ({PAPER})")
def test_every_digit_is_that_of_the_paper(tables: Appendix) -> None:
    # A5 stands before the caption of A4 in the text, but its numbers after those of A4.
    printed = _printed()
    assert len(printed) == len(tables.tables) == 6
    for table, expected in zip(tables.tables, printed, strict=True):
        assert {k: dict(v) for k, v in table.printed.items()} == expected, table.name


@pytest.mark.skipif(not PAPER.is_file(), reason=f"the paper's text is not there ({PAPER})")
def test_every_value_of_table_4_is_that_of_the_paper(tables: Appendix) -> None:
    text = PAPER.read_text(encoding="utf-8")
    text = text[text.index("| Parameter | For Positive Velocity") : text.index("Table 4. Selected")]
    rows = [line for line in text.splitlines() if re.search(r"\d\.\d{4}", line)]
    columns = [re.findall(r"-?\d+\.\d+", row) for row in rows]
    order = ("m_x", "X_u", "X_uabsu", "m_z", "Z_w", "Z_g", "I_zz", "N_r")
    for place, way in enumerate(("forward", "backward")):
        assert [tables.adopted[way][q] for q in order] == [column[place] for column in columns]


def _of(remarks: list[Remark], kind: str) -> list[Remark]:
    return [r for r in remarks if r.kind == kind]


def test_case_9_repeats_case_5_in_all_six_tables(remarks: list[Remark]) -> None:
    assert [r.where for r in _of(remarks, "repeated")] == [f"A{i}, cases 5 and 9" for i in range(1, 7)]


def test_two_signs_change_between_table_a2_and_table_4(remarks: list[Remark]) -> None:
    assert [r.where for r in _of(remarks, "sign")] == ["A2, case 11, X_u", "A2, case 11, X_uabsu"]


def test_z_g_of_case_8_is_an_outlier_copied_from_a4(remarks: list[Remark]) -> None:
    (outlier,), (copied,) = _of(remarks, "outlier"), _of(remarks, "copied")
    assert outlier.where == copied.where == "A5, case 8, Z_g"
    assert "lead to -12.415: 17.7 standard deviations away" in outlier.text
    assert "-14.3098727 in A4" in copied.text


def test_case_11_has_not_the_lowest_variance(remarks: list[Remark]) -> None:
    found = {r.where: r.text for r in _of(remarks, "selection")}
    assert list(found) == ["A1, case 11", "A3, case 11"]
    assert found["A1, case 11"].endswith("but case 3 has 0.00571343")
    assert found["A3, case 11"].endswith("but case 6 has 0.006110739")


def test_sums_that_do_not_add_up(remarks: list[Remark]) -> None:
    inertia, buoyancy = _of(remarks, "sum")
    assert inertia.where == "A6, case 8, I_zz"
    assert "0.023659776, but Table 4 has 0.0240417, 1.61% away" in inertia.text
    assert "-14.715 N, but Table 4 has -14.309872, 2.75% away" in buoyancy.text


def test_linear_surge_damping_is_insignificant(remarks: list[Remark]) -> None:
    found = {r.where: r.text[-8:] for r in _of(remarks, "insignificant")}
    assert found == {"A2, case 11, X_u": "t = 0.80", "A3, case 11, X_u": "t = 0.47"}


def test_validity_is_counted(tables: Appendix, remarks: list[Remark]) -> None:
    counts = {
        t.name: sum(t.physical(c, tables.body[t.quantities[0]]) for c in t.cases) for t in tables.tables
    }
    # By hand from the printed tables; in A2 every damping is printed with a minus.
    assert counts == {"A1": 5, "A2": 0, "A3": 5, "A4": 6, "A5": 5, "A6": 2}
    assert len(_of(remarks, "invalid")) == 6


def test_sound_tables_leave_nothing_to_remark(tables: Appendix) -> None:
    """Each remark goes when the number that it is about is mended."""
    (table,) = (t for t in tables.tables if t.name == "A5")
    mended = {k: dict(v) for k, v in table.printed.items()}
    mended["Z_g"]["8"] = "-12.4147882"
    for row in mended.values():
        row["9"] = f"{float(row['9']) * 1.01:.8f}"
    whole = replace(
        tables, tables=tuple(replace(t, printed=mended) if t is table else t for t in tables.tables)
    )
    kinds = {r.kind for r in audit(whole) if r.where.startswith("A5")}
    assert kinds == {"invalid"}
    assert set(KINDS) >= kinds
