"""Small damage to files: to bytes, words, lines, columns of a table, and the way it is packed."""

from __future__ import annotations

import gzip
import io
import random
import re
from collections.abc import Callable, Sequence

import polars as pl

Mutation = Callable[[bytes, random.Random], bytes]

#: What stands for a value where files are edited by hand, or by programs that do not know undertow.
ODD_VALUES = (
    *(
        "0",
        "-0.0",
        "1",
        "-1",
        "2",
        "nan",
        "-nan",
        "inf",
        "-inf",
        "1e308",
        "-1e308",
        "1e400",
        "1e-308",
        "1e-320",
    ),
    *("1e30", "-1e-30", "1e12", "-1e6", "2147483648", "9223372036854775807", "9223372036854775808", "1e18"),
    *("-9223372036854775809", "0x7f", "0b1", "0o17", "1_000", "01", "1.", ".5", "+1", "1,5", "١", "½"),
    *(
        '""',
        '"x"',
        '" "',
        '"1 kg"',
        '"1 m"',
        '"nan kg"',
        '"1e999 m"',
        '"deg"',
        '"1 m/s/s/s"',
        '"5%"',
        '"-1 N"',
    ),
    *("true", "false", "[]", "[[]]", "[1, 2, 3]", "{}", "{ value = 1 }", "{ value = 0, estimate = true }"),
    *(
        "2024-05-01",
        "2024-05-01T12:00:00Z",
        "12:00:00",
        "null",
        "NA",
        "None",
        "#",
        "'",
        '"',
        "\\",
        "\x00",
        "\ufeff",
    ),
    *("__class__", "surge", "u_dot", "psi", "tau_X", "f1", "kg", "é", "\u202e", "a" * 5000, "9" * 400),
)
_WORD = re.compile(r'"[^"\n]*"|[A-Za-z_][A-Za-z0-9_]*|[+-]?[0-9.]+(?:[eE][+-]?[0-9]+)?')
_NUMBER = re.compile(r"(?<![A-Za-z_])[+-]?[0-9]+(?:\.[0-9]*)?(?:[eE][+-]?[0-9]+)?")
_FACTORS = (-1.0, 0.0, 1e-9, 1e-3, 0.1, 10.0, 57.29577951308232, 1e3, 1e6, 1e9)
_ODD_BYTES = (
    b"\x00",
    b"\xff",
    b"\xef\xbb\xbf",
    b"\r\n",
    b"\x1f\x8b",
    b"PAR1",
    b"\n\n",
    b"\x80",
    b"\xed\xa0\x80",
)


def mutated(content: bytes, rng: random.Random, among: Sequence[Mutation]) -> bytes:
    """A file with one to four things changed, most often one."""
    for _ in range(rng.choice((1, 1, 1, 2, 2, 4))):
        content = rng.choice(among)(content, rng)
    return content


# --- bytes --------------------------------------------------------------------------------------
def flip(content: bytes, rng: random.Random) -> bytes:
    """One bit the other way."""
    if not content:
        return b"\x01"
    place = rng.randrange(len(content))
    return content[:place] + bytes([content[place] ^ 1 << rng.randrange(8)]) + content[place + 1 :]


def cut(content: bytes, rng: random.Random) -> bytes:
    """The end is missing."""
    return content[: rng.randrange(len(content) + 1)]


def insert(content: bytes, rng: random.Random) -> bytes:
    """Bytes that do not belong there."""
    place = rng.randrange(len(content) + 1)
    return content[:place] + rng.choice((*_ODD_BYTES, rng.randbytes(rng.randrange(1, 9)))) + content[place:]


def drop(content: bytes, rng: random.Random) -> bytes:
    """Some bytes are missing in the middle."""
    begin = rng.randrange(len(content) + 1)
    return content[:begin] + content[begin + rng.randrange(1, 40) :]


def repeat(content: bytes, rng: random.Random) -> bytes:
    """A part stands there twice."""
    begin = rng.randrange(len(content) + 1)
    end = begin + rng.randrange(1, 400)
    return content[:end] + content[begin:]


# --- text ---------------------------------------------------------------------------------------
def _text(content: bytes) -> str:
    return content.decode("utf-8", "surrogateescape")


def _bytes(text: str) -> bytes:
    return text.encode("utf-8", "surrogateescape")


def odd_value(content: bytes, rng: random.Random) -> bytes:
    """A word is replaced by a value that nobody thought of."""
    return _one(_WORD, content, rng, lambda word: rng.choice(ODD_VALUES))


def scaled(content: bytes, rng: random.Random) -> bytes:
    """A number is off by a power of ten, its sign, or from degrees to radians."""
    return _one(_NUMBER, content, rng, lambda number: repr(float(number) * rng.choice(_FACTORS)))


def other_word(content: bytes, rng: random.Random) -> bytes:
    """A word is replaced by another one of the file."""
    words = _WORD.findall(_text(content)) or ["x"]
    return _one(_WORD, content, rng, lambda word: rng.choice(words))


def typo(content: bytes, rng: random.Random) -> bytes:
    """A letter of a word is missing, or stands there twice."""

    def wrong(word: str) -> str:
        place = rng.randrange(len(word))
        return word[:place] + rng.choice(("", 2 * word[place])) + word[place + 1 :]

    return _one(_WORD, content, rng, wrong)


def _one(pattern: re.Pattern[str], content: bytes, rng: random.Random, change: Callable[[str], str]) -> bytes:
    text = _text(content)
    found = list(pattern.finditer(text))
    if not found:
        return content
    match = rng.choice(found)
    return _bytes(text[: match.start()] + change(match[0]) + text[match.end() :])


def lines(content: bytes, rng: random.Random) -> bytes:
    """A line is missing, twice there, or in another place."""
    text = _text(content).splitlines(keepends=True)
    if not text:
        return content
    line = text.pop(rng.randrange(len(text)))
    for _ in range(rng.randrange(3)):
        text.insert(rng.randrange(len(text) + 1), line)
    return _bytes("".join(text))


# --- tables -------------------------------------------------------------------------------------
def cells(content: bytes, rng: random.Random) -> bytes:
    """Two cells change places, or one is too much or missing in a row, or a whole column is odd."""
    rows = [line.split(",") for line in _text(content).splitlines()]
    wide = [i for i, row in enumerate(rows) if len(row) > 1]
    if not wide:
        return content
    row = rows[rng.choice((wide[0], rng.choice(wide)))]
    i, j = rng.randrange(len(row)), rng.randrange(len(row))
    kind = rng.randrange(4)
    if kind == 0:
        row[i], row[j] = row[j], row[i]
    elif kind == 1:
        del row[i]
    elif kind == 2:
        row.insert(i, row[j])
    else:
        value = rng.choice((*ODD_VALUES, ""))
        rows[1:] = [[*r[:i], value, *r[i + 1 :]] if rng.random() < 0.9 else r for r in rows[1:]]
    return _bytes("\n".join(",".join(r) for r in rows) + "\n")


_TYPES: tuple[Callable[[pl.Expr], pl.Expr], ...] = (
    lambda c: c.cast(pl.String),
    lambda c: c.cast(pl.String).cast(pl.Categorical),
    lambda c: c.cast(pl.String).cast(pl.Binary),
    lambda c: c.is_null(),
    lambda c: pl.lit(None),
    lambda c: c.cast(pl.Int8, strict=False),
    lambda c: c.cast(pl.Int64, strict=False),
    lambda c: (1e9 * c).cast(pl.UInt64, strict=False),
    lambda c: c.cast(pl.Float32, strict=False),
    lambda c: (1e3 * c).cast(pl.Int64, strict=False).cast(pl.Datetime("ms")),
    lambda c: (1e3 * c).cast(pl.Int64, strict=False).cast(pl.Datetime("us")).dt.replace_time_zone("UTC"),
    lambda c: c.cast(pl.Int32, strict=False).cast(pl.Date),
    lambda c: (1e9 * c).cast(pl.Int64, strict=False).cast(pl.Time, strict=False),
    lambda c: (1e9 * c).cast(pl.Int64, strict=False).cast(pl.Duration("ns")),
    lambda c: c.cast(pl.Decimal(20, 3), strict=False),
    lambda c: pl.concat_list([c, c]),
    lambda c: pl.struct(c.alias("inside")),
    lambda c: c.shift(1),
    lambda c: c.reverse(),
)


def parquet(content: bytes, rng: random.Random) -> bytes:
    """The same table as Parquet, in most cases with a column of another type or another name."""
    try:
        table = pl.read_csv(content, infer_schema_length=None)
        name = rng.choice(table.columns)
        if rng.random() < 0.8:
            table = table.with_columns(rng.choice(_TYPES)(pl.col(name)).alias(name))
        else:
            table = table.rename({name: rng.choice(("u", "t", " t", "", "\n", "é", "f1"))})
        packed = io.BytesIO()
        table.write_parquet(packed)
    except (pl.exceptions.PolarsError, OSError):  # no table any more, or no such type for this column
        return content
    return packed.getvalue()


def zipped(content: bytes, rng: random.Random) -> bytes:
    """Packed by gzip."""
    return gzip.compress(content, 1, mtime=0)


BYTES: tuple[Mutation, ...] = (flip, cut, insert, drop, repeat)
TEXT: tuple[Mutation, ...] = (odd_value, odd_value, odd_value, scaled, other_word, typo, lines)
OF_TEXT = (*TEXT, *TEXT, *BYTES)
OF_TABLES = (*TEXT, *BYTES, cells, cells, cells, cells, parquet, parquet, zipped)
