"""The dive in the format that a module of tests is about, written and read once."""

from __future__ import annotations

from pathlib import Path

import pytest

from undertow.identification.logs.formats.fieldlog import FieldLog, read_field_log


@pytest.fixture(scope="module")
def log_path(request: pytest.FixtureRequest, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The dive as `written` of the module writes it into a folder."""
    written: Path = request.module.written(tmp_path_factory.mktemp("dive"))
    return written


@pytest.fixture(scope="module")
def log(log_path: Path) -> FieldLog:
    """That file, read."""
    return read_field_log(log_path)
