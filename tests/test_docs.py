"""Pages of the site: what they say runs, is there, and leads somewhere."""

from __future__ import annotations

import functools
import importlib
import importlib.util
import re
import subprocess
import sys
import tomllib
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import undertow
from undertow.identification.logs.mapping import read_mapping
from undertow.model.catalogue import catalogue, load_effects
from undertow.model.contract import check_effect
from undertow.model.loading import load_vehicle
from undertow.model.symbols import signals, symbol

pytestmark = pytest.mark.docs

ROOT = Path(__file__).parents[1]
DOCS = ROOT / "docs"
PAGES = sorted([*ROOT.glob("*.md"), *DOCS.glob("*.md"), *DOCS.glob("*.ipynb"), *DOCS.glob("examples/*.md")])
_LINK = re.compile(r"!?\[[^\]]*\]\(([^)\s]+)\)")


def _blocks(page: str, language: str) -> list[str]:
    text = (DOCS / page).read_text(encoding="utf-8")
    return re.findall(rf"^```{language}\n(.*?)^```", text, re.DOTALL | re.MULTILINE)


def _found(dotted: str) -> Any:
    """The object behind a dotted name: the longest prefix that is a module, then attributes."""
    parts = dotted.split(".")
    for cut in range(len(parts), 0, -1):
        module = ".".join(parts[:cut])
        try:
            there = importlib.util.find_spec(module) is not None
        except ModuleNotFoundError:  # a parent is no package
            there = False
        if there:
            return functools.reduce(getattr, parts[cut:], importlib.import_module(module))
    raise AssertionError(f"{dotted} is nowhere")


# --- write-an-effect.md -----------------------------------------------------------------------------
def _keel_damping(folder: Path) -> Any:
    (code,) = _blocks("write-an-effect.md", "python")
    path = folder / "keel_damping.py"
    path.write_text(code, encoding="utf-8")
    (cls,) = load_effects(path)
    return cls


def test_the_effect_of_the_page_keeps_the_contract_and_is_what_the_page_says(tmp_path: Path) -> None:
    cls = _keel_damping(tmp_path)
    assert [f.message for f in check_effect(cls, catalogue()) if not f.ok] == []
    s = signals()
    moment = cls().wrench(s)
    values = {s.nu_r[1]: -0.5, s.nu_r[5]: 0.4, symbol("N_absv_r"): -3.0}
    assert [float(x) for x in moment.subs(values)] == pytest.approx([0, 0, 0, 0, 0, -0.6])


def test_the_walk_through_is_short() -> None:
    (code,) = _blocks("write-an-effect.md", "python")
    assert len(code.splitlines()) <= 33


def test_a_vehicle_may_use_it_as_the_page_says(tmp_path: Path) -> None:
    _keel_damping(tmp_path)
    (table,) = _blocks("write-an-effect.md", "toml")
    vehicle_file, *_ = _blocks("your-own-log.md", "toml")
    first, rest = table.split("\n", 1)
    whole = vehicle_file.replace('name = "my-rov"', f'name = "my-rov"\n{first}') + rest
    whole = whole.replace('["surge", "yaw"]', '["surge", "sway", "yaw"]')
    whole = whole.replace("X_udot = {", "Y_vdot = 8.0\nX_udot = {")
    (tmp_path / "rov.toml").write_text(whole, encoding="utf-8")
    vehicle = load_vehicle(tmp_path / "rov.toml", effect_files=[tmp_path / "keel_damping.py"])
    assert "N_absv_r" in vehicle.parameter_names
    assert vehicle.value_of("N_absv_r").estimate


# --- your-own-log.md --------------------------------------------------------------------------------
def test_the_files_of_the_page_are_read(tmp_path: Path) -> None:
    vehicle_file, wrench, _, mapping, *_ = _blocks("your-own-log.md", "toml")
    (tmp_path / "my-rov.toml").write_text(vehicle_file, encoding="utf-8")
    (tmp_path / "log.toml").write_text(mapping, encoding="utf-8")
    vehicle = load_vehicle(tmp_path / "my-rov.toml")
    assert vehicle.velocity_names == ("u", "r")
    assert vehicle.command_names == ("port", "starboard")
    channels = {c.channel for c in read_mapping(tmp_path / "log.toml").columns.values()}
    assert {*vehicle.command_names, *vehicle.velocity_names} <= channels
    (tmp_path / "my-rov.toml").write_text(f"{vehicle_file}\n{wrench}", encoding="utf-8")
    commands = ("port", "starboard", "surge_force", "yaw_moment")
    assert load_vehicle(tmp_path / "my-rov.toml").command_names == commands


# --- pictures of the catalogue ----------------------------------------------------------------------
@pytest.fixture(scope="module")
def drawn() -> Any:
    """The module that draws the pictures."""
    spec = importlib.util.spec_from_file_location("signature_picture", DOCS / "_ext" / "signature_picture.py")
    assert spec is not None
    assert spec.loader is not None
    module = sys.modules[spec.name] = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


def test_a_force_is_drawn_over_the_motion_that_it_depends_on(drawn: Any) -> None:
    surge, roll = drawn.panels(catalogue()["linear_damping"])
    assert (surge.x_label, surge.y_label) == ("u [m/s]", "surge force X [N]")
    assert (roll.x_label, roll.y_label) == ("p [rad/s]", "roll moment K [N m]")
    np.testing.assert_allclose(surge.curves[""], -surge.x)
    assert surge.absent is None


def test_a_force_that_depends_on_two_motions_is_drawn_for_three_values_of_one(drawn: Any) -> None:
    sway, _ = drawn.panels(catalogue()["lift"])
    assert sway.x_label == "v [m/s]"
    assert list(sway.curves) == ["u = 0.5 m/s", "u = 1 m/s", "u = 1.5 m/s"]
    for u, curve in zip((0.5, 1.0, 1.5), sway.curves.values(), strict=True):
        np.testing.assert_allclose(curve, u * sway.x, atol=1e-12)


def test_a_current_is_drawn_over_the_heading(drawn: Any) -> None:
    (panel,) = drawn.panels(catalogue()["ocean_current"])
    assert panel.x_label == "ψ [rad]"
    np.testing.assert_allclose(panel.curves[""], 0.5 * (np.cos(panel.x) + np.sin(panel.x)), atol=1e-12)


def test_a_lag_is_drawn_over_time_beside_the_command(drawn: Any) -> None:
    (panel,) = drawn.panels(catalogue()["thruster_lag"])
    on, late = 1.2, 5.0
    rising = (panel.x > on) & (panel.x < late)
    start = np.interp(on, panel.x, panel.curves[""])
    exact = 1 - (1 - start) * np.exp(-(panel.x[rising] - on) / 0.4)
    np.testing.assert_allclose(panel.curves[""][rising], exact, atol=0.02)
    np.testing.assert_allclose(panel.absent[rising], 1.0)
    assert panel.parameters == {"T_lag": "0.4 s"}


def test_a_delay_of_a_sensor_is_drawn_over_time_beside_the_truth(drawn: Any) -> None:
    (panel,) = drawn.panels(catalogue()["sensor_delay"])
    np.testing.assert_allclose(panel.curves[""], np.interp(panel.x - 0.3, panel.x, panel.absent))
    assert panel.y_label == "reported u [m/s]"


# --- architecture.md, glossary.md -------------------------------------------------------------------
def _journeys() -> list[str]:
    text = (DOCS / "architecture.md").read_text(encoding="utf-8")
    return sorted(set(re.findall(r"`(undertow\.[\w.]+)`", text)))


@pytest.mark.parametrize("name", _journeys())
def test_names_of_the_architecture_exist(name: str) -> None:
    assert _found(name) is not None


def test_every_package_has_a_row_in_the_architecture() -> None:
    packages = {
        f"undertow.{p.parent.name}"
        for p in Path(undertow.__file__).parent.glob("*/__init__.py")
        if any(q.name != "__init__.py" for q in p.parent.glob("*.py"))
    }
    text = (DOCS / "architecture.md").read_text(encoding="utf-8")
    assert set(re.findall(r"^\| `(undertow\.\w+)` \|", text, re.MULTILINE)) == packages


def test_the_glossary_is_short() -> None:
    (body,) = _blocks("glossary.md", "{glossary}")
    terms = [line for line in body.splitlines() if line and not line.startswith(" ")]
    assert 1 <= len(terms) <= 15


# --- commands on pages ------------------------------------------------------------------------------
@pytest.mark.parametrize("page", ["quickstart.md", "your-own-log.md", "write-an-effect.md"])
def test_options_on_the_page_exist(page: str) -> None:
    reference = (DOCS / "cli.md").read_text(encoding="utf-8")
    sections = dict(
        re.findall(r"^##+ undertow ([\w -]+)\n(.*?)(?=^##|\Z)", reference, re.DOTALL | re.MULTILINE)
    )
    lines = [
        x.split("#")[0] for b in _blocks(page, "sh") for x in b.splitlines() if x.startswith("undertow ")
    ]
    assert lines
    for line in lines:
        words = line.split()[1:]
        name = next(n for n in (" ".join(words[:2]), words[0]) if n in sections)
        missing = [w for w in words if w.startswith("--") and f"`{w}`" not in sections[name]]
        assert not missing, f"{page}: undertow {name} has no {missing}"


# --- the version ------------------------------------------------------------------------------------
def test_the_version_stands_in_one_place() -> None:
    assert not re.search(r"^version:", (ROOT / "CITATION.cff").read_text(encoding="utf-8"), re.MULTILINE)
    project = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))["project"]
    assert "version" not in project
    assert "version" in project["dynamic"]


def test_the_changelog_knows_the_version() -> None:
    assert undertow.__version__ in (ROOT / "CHANGELOG.md").read_text(encoding="utf-8")


# --- links ------------------------------------------------------------------------------------------
@pytest.mark.parametrize("page", PAGES, ids=lambda p: str(p.relative_to(ROOT)))
def test_relative_links_lead_somewhere(page: Path) -> None:
    text = re.sub(r"^```.*?^```", "", page.read_text(encoding="utf-8"), flags=re.DOTALL | re.MULTILINE)
    targets = [t.split("#")[0] for t in _LINK.findall(text) if not re.match(r"\w+:|#", t)]
    generated = {"catalogue.md"}  # written when the site is built
    broken = [t for t in targets if t and t not in generated and not (page.parent / t).exists()]
    assert not broken, f"{page.name} links to what is not there: {broken}"


# --- the site ---------------------------------------------------------------------------------------
def _needs_sphinx() -> None:
    for module in ("sphinx", "furo", "myst_nb", "ipykernel", "numpydoc", "latex2mathml"):
        pytest.importorskip(module, reason=f"{module} is not installed: pip install 'undertow[docs]'")


def _addresses(page: Path) -> list[str]:
    return re.findall(r'(?:src|href)="([^"#][^"]*)"', page.read_text(encoding="utf-8"))


@pytest.fixture(scope="module")
def site(tmp_path_factory: pytest.TempPathFactory) -> Path:
    _needs_sphinx()
    out = tmp_path_factory.mktemp("site")
    command = [sys.executable, "-m", "sphinx", "-q", "-W", "-b", "html", "-d", str(out / "t"), str(DOCS)]
    command += ["-D", "nb_execution_mode=off"]  # `make check-docs` runs the tutorial when it builds the site
    done = subprocess.run([*command, str(out / "html")], capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr
    return out / "html"


def test_the_site_needs_no_network(site: Path) -> None:
    loaded = re.compile(r'<(?:script|img|iframe)[^>]*src="(?:https?:)?//|<link[^>]*stylesheet[^>]*"https?://')
    assert [p.name for p in site.rglob("*.html") if loaded.search(p.read_text(encoding="utf-8"))] == []


def test_local_links_of_the_site_lead_somewhere(site: Path) -> None:
    broken = [
        f"{page.relative_to(site)}: {address}"
        for page in site.rglob("*.html")
        for address in _addresses(page)
        if not re.match(r"\w+:|//", address) and not (page.parent / re.split(r"[?#]", address)[0]).exists()
    ]
    assert broken == []


def test_the_catalogue_page_has_every_effect_with_its_equations(site: Path) -> None:
    text = (site / "catalogue.html").read_text(encoding="utf-8")
    assert [i for i in catalogue() if f"<h3>{i}<" not in text] == []
    assert text.count("<math ") >= len(catalogue())


def test_every_effect_of_the_catalogue_page_has_its_picture(site: Path) -> None:
    text = (site / "catalogue.html").read_text(encoding="utf-8")
    parts = dict(re.findall(r'aria-label="Signature of (\w+)">(.*?)</figure>', text, re.DOTALL))
    assert set(parts) == set(catalogue())
    for effect, part in parts.items():
        labels = re.findall(r"<text[^>]*>([^<]*)</text>", part)
        assert "<svg" in part, effect
        assert any(label.endswith("]") or label.startswith("output of") for label in labels), effect


def test_the_api_page_has_every_public_name(site: Path) -> None:
    text = (site / "api.html").read_text(encoding="utf-8")
    names = [n for n in undertow.__all__ if not n.startswith("_") and getattr(undertow, n).__doc__]
    assert [n for n in names if f'id="undertow.{n}"' not in text] == []
