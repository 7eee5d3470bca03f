"""The size of an effect where more than one is missing."""

from pathlib import Path

import undertow as ut
from benchmarks.real.cases import without
from tests.identification.logs_of import prepared
from undertow.identification.diagnosis.bench import open_bench
from undertow.identification.diagnosis.consistency import size_inconsistency
from undertow.identification.diagnosis.rounds import try_all
from undertow.model.catalogue import catalogue

DATA = Path(ut.__file__).parent / "demo_data" / "cfd-surge"


def test_what_else_is_missing_moves_the_size_of_an_effect() -> None:
    """A box pushed in a flow solver, by a model without added mass and without what its wake does.

    Added mass comes out different at the beginning and the end of the run; beside a current, which takes over
    what the wake does, it is the same everywhere.
    """
    vehicle = without(ut.load_vehicle("box-hull"), "added_mass")
    multistep, step = (
        ut.read_log(DATA / f"surge_{name}_coarse.csv.gz", mapping=DATA / "log.toml")
        for name in ("multistep", "step")
    )
    bench = open_bench(vehicle, *prepared(vehicle, [multistep], [step]))
    known = {name: catalogue()[name] for name in ("entrained_water", "ocean_current")}
    found = {f.id: f for f in try_all(bench, known, lambda done, words: None).findings}
    mass, current = found["entrained_water"], found["ocean_current"]
    assert "its size would have to vary from" in size_inconsistency(mass, bench)
    assert size_inconsistency(mass, bench, [mass, current]) == ""
