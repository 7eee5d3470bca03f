"""What was worked out is used again for the same log and model, and for no other."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import polars as pl
import pytest

from tests.quick import first_quick
from undertow.errors import UndertowError
from undertow.files import sha256_of
from undertow.fleet.diagnose import Store
from undertow.fleet.engine import InProcess
from undertow.fleet.partitions import content_of, files_digest
from undertow.fleet.reduction import Job, Reduced, reduce_log, with_fingerprint
from undertow.fleet.rollouts import RolloutJob, Source, rollouts, windows_of

SIDE = """
import sympy as sm
from undertow.model.effect import Actuation, Measurement
from undertow.model.parameter import Parameter


class Weak(Actuation):
    "Thrust that is a little less."

    id = "weak"
    reference = "a test"
    signature = "less thrust"
    stage = 36
    weakness = Parameter("1", "share of the thrust that is lost", (-1, 1))

    def output(self, upstream, s):
        return upstream * (1 - GAIN * self.weakness)


class Skewed(Measurement):
    "A log of the speed that reads too much."

    id = "skewed"
    reference = "a test"
    signature = "more speed"
    skew = Parameter("1", "share of what it reads too much", (-1, 1))

    def reported(self, eta, nu, s):
        return eta, nu * (1 + SCALE * self.skew)
"""


@pytest.mark.parametrize("within", first_quick([True, False]))
def test_an_edited_actuation_or_sensor_is_another_model(fleet: Path, tmp_path: Path, within: bool) -> None:
    """Whether the vehicle has the effect, or it is only a column."""
    text = (fleet / "craft.toml").read_text()
    more = "\n[effects.weak]\nweakness = 0.1\n\n[effects.skewed]\nskew = 0.1\n"
    vehicle = tmp_path / "craft.toml"
    vehicle.write_text(text.replace("\n[[thrusters]]", f"{more}\n[[thrusters]]", 1) if within else text)
    contents = []
    for name, gain, scale in (("one", 1, 1), ("stronger", 2, 1), ("longer", 1, 2)):
        effects = tmp_path / f"{name}.py"
        effects.write_text(SIDE.replace("GAIN", str(gain)).replace("SCALE", str(scale)))
        panel = with_fingerprint(Job(str(vehicle), (str(effects),)))[1]
        contents.append(str([content_of(model) for model in panel.models]))
    assert len(set(contents)) == 3


@pytest.mark.slow
def test_another_prior_is_another_result(fleet: Path, tmp_path: Path) -> None:
    other, text = tmp_path / "craft.toml", (fleet / "craft.toml").read_text()
    found = {with_fingerprint(Job(str(fleet / "craft.toml")))[0].fingerprint}
    for edit in (("sigma = 0.5", "sigma = 0.6"), (", sigma = 1.5 }", " }")):
        other.write_text(text.replace(*edit))
        found.add(with_fingerprint(Job(str(other)))[0].fingerprint)
    assert len(found) == 3


def test_the_bytes_of_effects_are_in_the_fingerprint(fleet: Path, tmp_path: Path) -> None:
    effects = tmp_path / "mine.py"
    found = set()
    for scale in ("1", "1 + 0"):
        effects.write_text(SIDE.replace("GAIN", "1").replace("SCALE", scale))
        found.add(with_fingerprint(Job(str(fleet / "craft.toml"), (str(effects),)))[0].fingerprint)
    assert len(found) == 2


def test_a_damaged_stored_file_is_not_known(tmp_path: Path) -> None:
    store, kept = Store(tmp_path), Reduced(("a",), np.array([[2.0, 1.0], [0.0, 3.0]]), 7, 1.5, 4)
    store.put("job", "log", kept)
    path = next((tmp_path / "partitions").iterdir())
    whole = path.read_bytes()
    for place in range(len(whole)):
        path.write_bytes(bytes([*whole[:place], whole[place] ^ 0x5A, *whole[place + 1 :]]))
        found = store.get("job", "log")
        assert found is None or (found.names == kept.names and (found.factor == kept.factor).all()), place
        path.write_bytes(whole[:place])
        assert store.get("job", "log") is None
    path.write_bytes(whole)
    assert store.get("job", "log").samples == 7


def test_a_living_worker_reads_changed_files_again(fleet: Path, tmp_path: Path) -> None:
    """Another vehicle or log at the same place is never mistaken for the one before."""
    vehicle, log = tmp_path / "craft.toml", tmp_path / "log.parquet"
    text, table = (
        (fleet / "craft.toml").read_text(),
        pl.read_parquet(next((fleet / "logs").rglob("*.parquet"))),
    )
    vehicle.write_text(text)
    table.write_parquet(log)
    job = RolloutJob(str(vehicle), horizon=10.0)
    seen = [rollouts(job, [str(log)], 5, InProcess())[0]]
    table.with_columns(pl.col("u") + 1.0).write_parquet(log)
    seen.append(rollouts(job, [str(log)], 5, InProcess())[0])
    vehicle.write_text(text.replace("m = 20.0", "m = 40.0"))
    seen.append(rollouts(job, [str(log)], 5, InProcess())[0])
    first, moved, heavy = (one[0] for one in seen)
    u = first.names.index("u")
    np.testing.assert_allclose(moved.measured[:, u], first.measured[:, u] + 1.0)
    assert np.abs(heavy.median - moved.median).max() > 0.1


def test_a_worker_with_other_files_refuses(fleet: Path, tmp_path: Path) -> None:
    log = next((fleet / "logs").rglob("*.parquet"))
    job = RolloutJob(str(fleet / "craft.toml"), horizon=10.0)
    with pytest.raises(UndertowError, match="this worker reads a different"):
        windows_of(replace(job, files="0" * 64), Source(str(log), sha256_of(log)))
    mine = replace(job, files=files_digest(job.vehicle, ()))
    with pytest.raises(UndertowError, match="is different for this worker"):
        windows_of(mine, Source(str(log), "0" * 64))
    assert windows_of(mine, Source(str(log), sha256_of(log))) == 5


def test_a_log_that_is_still_written_to_is_not_kept(fleet: Path) -> None:
    job = with_fingerprint(Job(str(fleet / "craft.toml")))[0]
    log = next((fleet / "logs").rglob("*.parquet"))
    with pytest.raises(UndertowError, match="was changed while it was read"):
        reduce_log(job, str(log), "0" * 64)
    assert reduce_log(job, str(log), sha256_of(log)).samples > 0
