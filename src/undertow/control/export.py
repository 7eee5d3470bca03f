"""C code of a controller for use without undertow: one step function, and nothing behind it but math.h."""

from __future__ import annotations

from collections.abc import Iterable
from functools import cached_property
from importlib.resources import files
from pathlib import Path

import undertow
from undertow.codegen.export import Report, comment, filled, identifier, listing, slug, strings
from undertow.codegen.manifest import Entry
from undertow.codegen.plain import plain_c
from undertow.errors import UndertowError
from undertow.files import make_folder, together, write_whole
from undertow.model.symbols import FORCE, FORCE_UNITS, POSE, VELOCITY, VELOCITY_UNITS

from .controller import Controller

PICTURES = "figures"
_POSE_UNITS = ("m",) * 3 + ("rad",) * 3
_UNITS = dict(
    zip(
        (*POSE, *VELOCITY, *(f"tau_{f}" for f in FORCE)),
        (*_POSE_UNITS, *VELOCITY_UNITS, *FORCE_UNITS),
        strict=True,
    )
)
_HEADING = """\
/* Desired heading from where the vehicle begins to the set-point, rad. */
double @LOWER@_heading(double x_0, double y_0, double x_d, double y_d)"""
_RULES = {
    "atan2": "  return atan2(y_d - y_0, x_d - x_0);",
    "atan": """\
  if (x_d == x_0) return y_d > y_0 ? acos(0.0) : y_d < y_0 ? -acos(0.0) : 0.0;
  return atan((y_d - y_0) / (x_d - x_0));""",
}


class ControllerExport:
    """The generated files of a controller.

    Parameters
    ----------
    controller : Controller
        The controller.

    Raises
    ------
    UndertowError
        If the name of the vehicle or of the gains gives no folder name, or that of the pictures.

    Attributes
    ----------
    folder : Path
        Where the files go, under the folder of all that is generated.
    """

    def __init__(self, controller: Controller) -> None:
        self._controller = controller
        self._vehicle = controller.gains.plant.vehicle
        self.folder = Path(slug(self._vehicle.name)) / slug(controller.gains.name)
        if self.folder.name == PICTURES:
            raise UndertowError(
                f"gain set '{controller.gains.name}' would have the folder '{PICTURES}', which is that of "
                "the pictures: give it another name"
            )
        self._name = identifier("-".join(self.folder.parts))

    def write(self, out: Path) -> Report:
        """Write controller.c and controller.h to a folder of their own in that of the vehicle.

        Raises
        ------
        UndertowError
            If the folder cannot be written.
        """
        report = self.check(out)
        with together():
            make_folder(report.folder)
            for name, text in self.texts.items():
                write_whole(report.folder / name, text)
        return report

    def check(self, out: Path) -> Report:
        """Compare what lies in `out` with the controller; without changes it is current."""
        folder = out / self.folder
        found = {name: _text(folder / name) for name in self.texts}
        changed = [
            f"{name} is not as it would be generated" for name in found if found[name] != self.texts[name]
        ]
        first = not any(found.values())
        return Report(folder, first, () if first else tuple(changed))

    @cached_property
    def texts(self) -> dict[str, str]:
        """Text of each file by name."""
        template = files("undertow.control") / "templates" / "controller.h"
        header = filled(template.read_text(encoding="utf-8"), self._fields)
        return {"controller.c": self._source(), "controller.h": header}

    # --- the entries ------------------------------------------------------------------------------
    def _entries(self) -> dict[str, list[Entry]]:
        controller, law = self._controller, type(self._controller.gains.law)
        pose, velocity = self._vehicle.pose_names, self._vehicle.velocity_names
        units = {str(g.symbol(c)): g.unit(c) for g in law.gains for c in pose}
        gains = zip(controller.gain_names, controller.gain_values(), strict=True)
        forces = [f"tau_{FORCE[i]}" for i in self._vehicle.dof_indices]
        return {
            "report": [Entry(n, _UNITS[n]) for n in (*pose, *velocity)],
            "desired": [Entry(n, _UNITS[n]) for n in pose],
            "state": [Entry(n, "") for n in controller.state_names],
            "gain": [Entry(n, units[n], value) for n, value in gains],
            "command": [Entry(n, _UNITS.get(n, "command")) for n in controller.command_names],
            "force": [Entry(n, _UNITS[n]) for n in forces],
        }

    @cached_property
    def _fields(self) -> dict[str, object]:
        entries = self._entries()
        sizes = dict(zip(("NY", "NR", "NS", "NK", "NU", "NT"), map(len, entries.values()), strict=True))
        words = ("REPORTS", "DESIRED", "STATES", "GAINS", "COMMANDS", "FORCES")
        lists = dict(zip(words, map(listing, entries.values()), strict=True))
        gains = self._controller.gains
        named = {"LOWER": self._name, "UPPER": self._name.upper(), "VERSION": undertow.__version__}
        titles = {"TITLE": comment(gains.name), "VEHICLE": comment(self._vehicle.name), "LAW": gains.law.id}
        declared = f"\n{filled(_HEADING, named)};\n" if self._plane else ""
        return {**named, **titles, **sizes, **lists, "HEADING_DECLARED": declared}

    @property
    def _plane(self) -> bool:
        return {"x", "y", "psi"} <= set(self._vehicle.pose_names)

    # --- the source -------------------------------------------------------------------------------
    def _source(self) -> str:
        name, entries = self._name, self._entries()
        gains = self._controller.gains
        head = f"/* Controller '{comment(gains.name)}', generated by undertow; see controller.h. */"
        named = ("report", "state", "gain", "command")
        lines = [head, '#include "controller.h"', "", "#include <math.h>", ""]
        lines += [strings(f"{name}_{what}_names", entries[what]) for what in named]
        lines += [f"const double {name}_gains[] = {{{_numbers(self._controller.gain_values())}}};", ""]
        lines += [plain_c(self._controller.sampled, f"{name}_sample", prefix="static "), self._functions()]
        return "\n".join(lines)

    def _functions(self) -> str:
        name, start = self._name, self._controller.initial_states()
        states = "\n".join(f"  s[{i}] = {value!r};" for i, value in enumerate(start))
        arguments = (
            "const double *y, const double *r, const double *k, double dt, double *s, double *u, double *tau"
        )
        parts = [
            f"void {name}_start(double *s) {{\n{states}\n}}",
            f"void {name}_step({arguments}) {{\n  {name}_sample(y, r, s, k, &dt, u, s, tau);\n}}",
        ]
        if self._plane:
            rule = _RULES[self._controller.gains.schedule.heading]
            parts.append(f"{filled(_HEADING, {'LOWER': name})} {{\n{rule}\n}}")
        return "\n\n".join(parts) + "\n"


def _numbers(values: Iterable[float]) -> str:
    return ", ".join(map(repr, values))


def _text(path: Path) -> str:
    try:
        return path.read_text(encoding="utf-8")
    except (OSError, UnicodeDecodeError):
        return ""
