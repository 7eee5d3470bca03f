"""Controllers in C: compiled as a user would, and compared with Python sample for sample."""

from __future__ import annotations

import ctypes
import subprocess
import sys
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from tests.quick import first_quick
from undertow.codegen.compiler import Compiler, pointer
from undertow.codegen.library import Library
from undertow.codegen.spelling import slug
from undertow.control.controller import Controller
from undertow.control.controller_c import controller_c
from undertow.control.gains import GainTable, gains_from_table, load_gains
from undertow.control.laws import LAWS
from undertow.control.update import library_of
from undertow.model.loading import load_vehicle

pytestmark = pytest.mark.skipif(sys.platform == "win32", reason="compiles with options of cc")
STRICT = (
    "-std=c99",
    "-Wall",
    "-Wextra",
    "-Wpedantic",
    "-Wconversion",
    "-Werror",
    "-O1",
    "-ffp-contract=off",
    "-Isrc",
)
GAIN = {
    "K_1": 0.3,
    "K_2": 0.05,
    "K_Z": 0.2,
    "Lambda": 0.4,
    "width": 0.02,
    "K_P": 0.8,
    "K_V": 1.7,
    "K_I": 0.06,
}


def table(law: str, **more: object) -> GainTable:
    gains = {g.name: GAIN[g.name] for g in LAWS[law].gains}
    content = {"schema": "undertow/gains/1", "name": f"all of {law}", "law": law, "gains": gains}
    return GainTable.model_validate(content | more)


def auv(law: str) -> Controller:
    """Scheduled, with limits that are reached and integrals that are held."""
    limits = {"f1": 7.2, "f3": "7.2 N", "f2": 0.3}
    more = {"schedule": {"order": "yaw-first", "gate": "20 deg"}, "allocation": {"limits": limits}}
    return Controller(gains_from_table(table(law, unactuated=["sway"], **more), load_vehicle("mini-auv")))


def compiled(controller: Controller, compiler: Compiler, folder: Path) -> tuple[ctypes.CDLL, str]:
    """The exported files as a library, and the prefix of its functions."""
    library = Library(
        controller.gains.plant.vehicle, [(controller.gains.name, lambda c: controller_c(controller, c))]
    )
    made, part = library.write(folder).folder, slug(controller.gains.name).replace("-", "_")
    source = f"src/{library.name}_{part}.c"
    command = [*compiler.command, *STRICT, "-fPIC", "-shared", source, "-lm", "-o", f"{part}.so"]
    done = subprocess.run(command, cwd=made, capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr
    return ctypes.CDLL(str(made / f"{part}.so")), f"{library.name}_{part}"


@pytest.mark.parametrize("law", first_quick(LAWS, 3))
def test_the_step_in_c_is_that_of_python(law: str, c_compiler: Compiler, tmp_path: Path) -> None:
    assert_same(auv(law), c_compiler, tmp_path)


@pytest.mark.slow
def test_six_degrees_of_freedom_and_eight_thrusters(c_compiler: Compiler, tmp_path: Path) -> None:
    limits = {f"f{i}": 5.0 for i in range(1, 9)}
    gains = gains_from_table(table("pid", allocation={"limits": limits}), load_vehicle("bluerov2"))
    assert_same(Controller(gains), c_compiler, tmp_path)


def assert_same(controller: Controller, compiler: Compiler, folder: Path) -> None:
    """A walk of the reports towards the set-point; the states are carried on by each side on its own."""
    library, name = compiled(controller, compiler, folder)
    k, p = np.array(controller.gain_values()), np.array(list(controller.parametrised().values.values()))
    assert (np.array((ctypes.c_double * len(p)).in_dll(library, f"{name}_parameters_default")) == p).all()
    function, numbered = controller.sampled, controller.parametrised().control
    n, n_u = function.size1_in("r"), function.size1_out("u")
    s, expected = np.full(function.size1_in("s"), 7.0), np.array(controller.initial_states())
    getattr(library, f"{name}_start")(pointer(s))
    assert (s == expected).all()
    random = np.random.default_rng(5)
    r, y, u, tau = random.normal(size=n), np.zeros(2 * n), np.zeros(n_u), np.zeros(function.size1_out("tau"))
    limited = 0
    for i in range(400):
        y[:n] += 0.02 * (r - y[:n]) + 0.01 * random.normal(size=n)
        y[n:] = 0.1 * random.normal(size=n)
        dt = 0.05 + 0.01 * (i % 3)
        arguments = map(pointer, (y, r, s, p))
        getattr(library, f"{name}_step")(*arguments, ctypes.c_double(dt), *map(pointer, (u, s, tau)))
        found = [np.asarray(v).ravel() for v in numbered(y, r, expected, p, dt)]
        # With the numbers as constants CasADi sums in another order, and a thruster at its limit leaves a
        # system that only its damping makes regular: eight digits of sixteen are lost in what is left.
        for constant, python in zip(function(y, r, expected, k, dt), found, strict=True):
            assert np.asarray(constant).ravel() == pytest.approx(python, abs=1e-9, rel=1e-8)
        expected = found[1]
        for mine, python in zip((u, s, tau), found, strict=True):
            assert mine == pytest.approx(python, abs=1e-12, rel=1e-12)
        limited += bool((np.abs(u) >= controller.allocation.limits).any())
    assert limited > 5
    assert s[-1] == 1.0


def test_the_heading_rule_goes_along(c_compiler: Compiler, tmp_path: Path) -> None:
    for rule, expected in (("atan2", 2.356194490192345), ("atan", -0.7853981633974483)):
        change = lambda t, rule=rule: t.model_copy(  # noqa: E731
            update={"name": rule, "schedule": t.schedule.model_copy(update={"heading": rule})}
        )
        controller = Controller(load_gains("paper-pd", load_vehicle("mini-auv"), change))
        library, name = compiled(controller, c_compiler, tmp_path)
        heading = getattr(library, f"{name}_heading")
        heading.restype = ctypes.c_double
        assert heading(*map(ctypes.c_double, (0.0, 0.0, -1.0, 1.0))) == pytest.approx(expected, abs=1e-15)
        assert heading(*map(ctypes.c_double, (0.0, 0.0, 0.0, -1.0))) == pytest.approx(-np.pi / 2)


def test_the_source_needs_nothing_but_math() -> None:
    library = library_of(auv("pid").gains.plant.vehicle, [auv("pid").gains])
    lines = [line for text in library.texts.values() for line in text.splitlines()]
    assert {line for line in lines if line.startswith("#include <")} == {
        "#include <math.h>",
        "#include <stdio.h>",
    }
    own = library.texts["src/mini_auv_all_of_pid.c"].splitlines()
    assert [line for line in own if line.startswith("#include")] == ['#include "mini_auv_all_of_pid.h"']


def test_what_is_current_and_what_is_stale(tmp_path: Path) -> None:
    gains = auv("pd").gains
    vehicle = gains.plant.vehicle
    library = library_of(vehicle, [gains])
    assert library.check(tmp_path).first
    folder = library.write(tmp_path).folder
    assert folder == tmp_path / "mini-auv"
    assert library.check(tmp_path).changes == ()
    source = "src/mini_auv_all_of_pd.c"
    (folder / source).write_text("int x;\n")
    assert library.check(tmp_path).changes == (f"{source} is not as it was generated",)
    library.write(tmp_path)
    assert library.check(tmp_path).changes == ()
    stiffer = replace(gains, values=gains.values | {"K_P_x": 7.0})
    assert library_of(vehicle, [stiffer]).check(tmp_path).changes == (f"{source} has changed",)
    assert Library(vehicle).check(tmp_path).changes == (f"{source} is no longer part of it",)
