"""Hulls out of files: what they enclose, what is repaired, and how they are cut into panels."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from benchmarks.shape.hulls import SIDES, ball, box_mesh, cylinder_mesh, spheroid_mesh, stl
from undertow.errors import UndertowError
from undertow.shape.mesh import Mesh, base_mesh, bisected, read_hull, repaired
from undertow.shape.panels import curved, panels

FLU = np.diag([1.0, -1.0, -1.0])


def ascii_stl(mesh: Mesh) -> str:
    corners = "".join(
        "facet normal 0 0 0\nouter loop\n"
        + "".join("vertex {} {} {}\n".format(*p) for p in triangle)
        + "endloop\nendfacet\n"
        for triangle in mesh.corners.tolist()
    )
    return f"solid hull\n{corners}endsolid hull\n"


# what a hull encloses ---------------------------------------------------------------------------------------


def test_a_box_anywhere() -> None:
    away = np.array([3.0, -2.0, 5.0])
    hull = box_mesh().moved(away)
    a, b, c = SIDES
    assert hull.volume == pytest.approx(a * b * c, rel=1e-12)
    np.testing.assert_allclose(hull.centroid, away, rtol=1e-12)
    expected = a * b * c / 12 * np.diag([b**2 + c**2, a**2 + c**2, a**2 + b**2])
    np.testing.assert_allclose(hull.inertia, expected, rtol=1e-9, atol=1e-12)
    assert [hull.projected_area(i) for i in range(3)] == pytest.approx([b * c, a * c, a * b], rel=1e-9)


def test_inertia_turns_with_the_hull() -> None:
    turn = np.array([[0.8, -0.6, 0.0], [0.6, 0.8, 0.0], [0.0, 0.0, 1.0]])
    hull = box_mesh().moved([0.1, 0.2, 0.3])
    np.testing.assert_allclose(
        Mesh(hull.vertices @ turn.T, hull.faces).inertia, turn @ hull.inertia @ turn.T, atol=1e-12
    )


def test_a_spheroid_converges_to_what_is_known() -> None:
    a, r = 0.6, 0.2
    volume = 4 / 3 * np.pi * a * r**2
    known = np.array([volume, np.pi * r**2, np.pi * a * r, volume * 2 / 5 * r**2, volume * (a**2 + r**2) / 5])

    def wrong(times: int) -> np.ndarray:
        m = spheroid_mesh(2 * a, 2 * r, times)
        found = [m.volume, m.projected_area(0), m.projected_area(2), m.inertia[0, 0], m.inertia[1, 1]]
        return np.array(found) / known - 1

    np.testing.assert_allclose(wrong(4), 0.0, atol=0.01)
    # Four times the triangles, a quarter of the error.
    np.testing.assert_allclose(wrong(3) / wrong(4), 4.0, rtol=0.1)


def test_a_silhouette_has_gaps_and_counts_nothing_twice() -> None:
    left, right = box_mesh((1.0, 0.2, 0.2)).moved([0, -0.5, 0]), box_mesh((1.0, 0.2, 0.2)).moved([0, 0.5, 0])
    both = Mesh(
        np.concatenate([left.vertices, right.vertices]),
        np.concatenate([left.faces, right.faces + len(left.vertices)]),
    )
    assert both.projected_area(2) == pytest.approx(0.4, rel=1e-9)  # side by side
    assert both.projected_area(1) == pytest.approx(0.2, rel=1e-9)  # one behind the other


# files ------------------------------------------------------------------------------------------------------


def test_stl_binary_text_and_units(tmp_path: Path) -> None:
    binary = read_hull(stl(box_mesh(), tmp_path / "mm.stl", 1000.0), unit="mm")
    (tmp_path / "text.STL").write_text(ascii_stl(box_mesh()))
    text = read_hull(tmp_path / "text.STL")
    for hull in (binary, text):
        assert hull.remarks == ()
        assert len(hull.mesh.vertices) == 8
        assert hull.mesh.volume == pytest.approx(np.prod(SIDES), rel=1e-6)


def test_obj_with_quadrilaterals(tmp_path: Path) -> None:
    corners = [(x, y, z) for x in (0, 1) for y in (0, 1) for z in (0, 1)]
    quads = [(1, 2, 4, 3), (5, 7, 8, 6), (1, 5, 6, 2), (3, 4, 8, 7), (1, 3, 7, 5), (2, 6, 8, 4)]
    lines = ["# a cube", *("v {} {} {}".format(*c) for c in corners), "vn 0 0 1"]
    lines += ["f " + " ".join(f"{i}/1/1" for i in q) for q in quads[:3]]
    lines += ["f " + " ".join(str(i - 9) for i in q) for q in quads[3:]]
    (tmp_path / "cube.obj").write_text("\n".join(lines))
    hull = read_hull(tmp_path / "cube.obj")
    assert len(hull.mesh.faces) == 12
    assert hull.mesh.volume == pytest.approx(1.0)
    np.testing.assert_allclose(hull.mesh.centroid, 0.5)


def test_obj_counts_backwards_from_the_vertices_before_the_face(tmp_path: Path) -> None:
    corners = box_mesh().vertices
    blocks = [
        "\n".join(["v {} {} {}".format(*corners[i]) for i in face] + ["f -3 -2 -1"])
        for face in box_mesh().faces
    ]
    (tmp_path / "box.obj").write_text("\n".join(blocks))
    hull = read_hull(tmp_path / "box.obj").mesh
    assert (len(hull.vertices), len(hull.faces)) == (8, 12)
    assert hull.volume == pytest.approx(np.prod(SIDES), rel=1e-9)


def test_msh_by_meshio(tmp_path: Path) -> None:
    meshio = pytest.importorskip("meshio", reason="MSH files need undertow[bem]")
    hull = box_mesh()
    meshio.Mesh(hull.vertices, [("triangle", hull.faces)]).write(tmp_path / "box.msh", file_format="gmsh22")
    assert read_hull(tmp_path / "box.msh").mesh.volume == pytest.approx(np.prod(SIDES))
    (tmp_path / "bad.msh").write_text("nothing of the kind")
    with pytest.raises(UndertowError, match=r"bad.msh: meshio cannot read it"):
        read_hull(tmp_path / "bad.msh")


def test_axes_of_a_file(tmp_path: Path) -> None:
    off = box_mesh().moved([1.0, 2.0, 3.0])
    path = stl(off, tmp_path / "off.stl")
    np.testing.assert_allclose(read_hull(path).mesh.centroid, [1, 2, 3], rtol=1e-6)
    np.testing.assert_allclose(read_hull(path, frame="FLU").mesh.centroid, [1, -2, -3], rtol=1e-6)
    # x to starboard, y forward, z up.
    turned = read_hull(path, frame="rfu").mesh
    np.testing.assert_allclose(turned.centroid, [2, 1, -3], rtol=1e-6)
    np.testing.assert_allclose(turned.extents, [SIDES[1], SIDES[0], SIDES[2]], rtol=1e-6)
    assert turned.volume > 0
    for wrong in ("FRU", "FR", "FFD", "XYZ"):
        with pytest.raises(UndertowError, match="is not a right-handed set of axes"):
            read_hull(path, frame=wrong)


@pytest.mark.parametrize(
    ("name", "content", "message"),
    [
        ("a.stl", b"", "not an STL file, or cut off"),
        ("a.stl", bytes(80) + (5).to_bytes(4, "little") + bytes(60), "not an STL file, or cut off"),
        ("a.stl", bytes(84), "no triangles in it"),
        ("a.stl", b"solid x\nvertex 0 0\nendsolid", "1 vertices do not make triangles"),
        ("a.stl", b"solid x\nvertex 0 0 q\nendsolid", "a vertex is not three numbers"),
        ("a.stl", b"solid x\n" + b"vertex 0 0 nan\n" * 3, "is not a finite number"),
        ("a.obj", b"v 0 0 0\nv 1 0 0\nf 1 2 9\n", "names a vertex that is not there"),
        ("a.obj", b"v 0 0 0\nv 1 0 0\nf -1 -2 -3\nv 2 0 0\n", "names a vertex that is not there"),
        ("a.obj", b"v 0 0 0\nv 1 0 0\nf 0 1 2\nv 2 0 0\n", "names a vertex that is not there"),
        ("a.obj", b"v 0 0 0\nf 1 1 99999999999999999999\n", "a line is not valid OBJ"),
        ("a.obj", b"v 0 0\n", "a line is not valid OBJ"),
        ("a.obj", b"v 0 0 0\nv 1 0 0\nv 2 0 0\nf 1 2 2\n", "every triangle has no area"),
        ("a.step", b"", r"hulls are read from .stl, .obj and .msh files"),
    ],
)
def test_files_that_are_none(tmp_path: Path, name: str, content: bytes, message: str) -> None:
    (tmp_path / name).write_bytes(content)
    with pytest.raises(UndertowError, match=message):
        read_hull(tmp_path / name)


def test_a_file_that_is_not_there(tmp_path: Path) -> None:
    with pytest.raises(UndertowError, match=r"none.stl: cannot be read: No such file"):
        read_hull(tmp_path / "none.stl")


@pytest.mark.parametrize(("scale", "likely"), [(1000.0, "such as mm"), (0.01, "such as in, ft or km")])
def test_an_unlikely_size(tmp_path: Path, scale: float, likely: str) -> None:
    path = stl(box_mesh(), tmp_path / "a.stl", scale)
    with pytest.raises(UndertowError, match=likely):
        read_hull(path)
    assert read_hull(path, unit="m").mesh.extents.max() == pytest.approx(0.6 * scale, rel=1e-6)
    with pytest.raises(UndertowError, match="unit 'kg' is not a length"):
        read_hull(path, unit="kg")


# mending ----------------------------------------------------------------------------------------------------


def test_triangles_that_look_inward_are_turned() -> None:
    box = box_mesh()
    inward, remarks = repaired(Mesh(box.vertices, box.faces[:, ::-1]), "hull")
    assert inward.volume == pytest.approx(box.volume)
    assert remarks == ("all triangles faced inward: flipped",)
    faces = box.faces.copy()
    faces[[2, 7]] = faces[[2, 7], ::-1]
    some, remarks = repaired(Mesh(box.vertices, faces), "hull")
    assert some.volume == pytest.approx(box.volume)
    assert remarks == ("2 triangles faced the opposite way to their neighbours: flipped",)


def test_an_open_hull_is_refused_with_the_place() -> None:
    box = box_mesh()
    with pytest.raises(
        UndertowError, match=r"hull: the hull is open: 3 edges belong to 1 triangle.* near \("
    ):
        repaired(Mesh(box.vertices, box.faces[1:]), "hull")


def test_a_wall_inside_is_refused() -> None:
    box = box_mesh()
    wall = [[0, 1, 6], [1, 7, 6]]
    with pytest.raises(UndertowError, match="instead of 2"):
        repaired(Mesh(box.vertices, np.concatenate([box.faces, wall])), "hull")


def test_several_bodies_are_refused() -> None:
    one, other = box_mesh(), box_mesh((0.1, 0.1, 0.1)).moved([2.0, 0, 0])
    both = Mesh(
        np.concatenate([one.vertices, other.vertices]),
        np.concatenate([one.faces, other.faces + len(one.vertices)]),
    )
    with pytest.raises(UndertowError, match=r"2 separate bodies \(0.0605, 0.001 m\^3\)"):
        repaired(both, "hull")


def test_triangles_that_stand_there_twice_and_slivers_go() -> None:
    box = box_mesh()
    faces = np.concatenate([box.faces, box.faces[:2], [[0, 0, 1]]])
    mesh, _ = repaired(Mesh(box.vertices, faces), "hull")
    assert len(mesh.faces) == 12


# panels -----------------------------------------------------------------------------------------------------


def test_cutting_keeps_a_flat_hull_as_it_is() -> None:
    box = box_mesh()
    fine = bisected(box, 0.1)
    sides = np.linalg.norm(fine.corners - np.roll(fine.corners, 1, axis=1), axis=2)
    assert sides.max() <= 0.1
    assert fine.volume == pytest.approx(box.volume, rel=1e-12)
    assert fine.areas.sum() == pytest.approx(box.areas.sum(), rel=1e-12)
    assert repaired(fine, "cut")[1] == ()  # still closed, without a loose end


def test_panels_of_a_box_are_three_flat_meshes() -> None:
    coarse, middle, fine = panels(box_mesh(), 1600)
    assert 16 * len(coarse.faces) == 4 * len(middle.faces) == len(fine.faces) <= 1600
    for mesh in (coarse, middle, fine):
        assert mesh.volume == pytest.approx(np.prod(SIDES), rel=1e-9)


@pytest.mark.parametrize("finest", [320, 3200])
def test_what_is_coarse_enough_is_not_simplified(finest: int) -> None:
    count = finest // 16
    drawn = box_mesh()
    while 2 * len(drawn.faces) <= count:
        drawn = bisected(drawn, 0.99 * float(np.linalg.norm(np.diff(drawn.corners, axis=1), axis=2).max()))
    assert count / 3 < len(drawn.faces) <= count
    base = base_mesh(drawn, count)
    assert len(base.faces) <= count
    assert base.volume == pytest.approx(np.prod(SIDES), rel=1e-12)
    assert {tuple(v) for v in drawn.vertices} <= {tuple(v) for v in base.vertices}


def test_panels_that_miss_the_hull_are_refused() -> None:
    pytest.importorskip("igl", reason="simplifying needs undertow[bem]")
    drawn = spheroid_mesh(1.2, 0.4, 4)
    with pytest.raises(UndertowError, match=r"miss the volume of the hull by 7.\d% \(limit 5%\)"):
        panels(drawn, 320)
    assert panels(drawn, 800)[2].volume == pytest.approx(drawn.volume, rel=0.05)


@pytest.mark.parametrize("crease", [1e-9, 179.9])
def test_any_crease_gives_numbers(crease: float) -> None:
    assert np.isfinite(curved(ball(2), crease).vertices).all()


def test_a_coarsely_drawn_ball_is_rounded() -> None:
    """128 flat triangles miss 9% of the ball; four for each, by their normals, are as good as drawn."""
    coarse = ball(2)
    assert coarse.volume == pytest.approx(0.911 * 4 / 3 * np.pi, rel=0.002)
    assert curved(coarse, 45.0).volume == pytest.approx(ball(3).volume, rel=0.01)
    assert curved(coarse, 5.0).volume == pytest.approx(coarse.volume, rel=1e-9)


def test_a_box_has_no_curves() -> None:
    assert curved(box_mesh()).volume == pytest.approx(np.prod(SIDES), rel=1e-12)


def test_the_rim_of_a_cylinder_stays_sharp() -> None:
    pytest.importorskip("igl", reason="simplifying needs undertow[bem]")
    drawn = repaired(cylinder_mesh(2.0, 1.0, 24), "cylinder")[0]
    _, _, fine = panels(drawn, 3200)
    np.testing.assert_allclose(fine.extents[0], 2.0, rtol=1e-9)
    assert fine.volume == pytest.approx(np.pi / 2, rel=0.01)


def test_a_fine_mesh_is_simplified() -> None:
    pytest.importorskip("igl", reason="simplifying needs undertow[bem]")
    drawn = spheroid_mesh(1.2, 0.4, 5)
    assert len(drawn.faces) == 8192
    assert len(base_mesh(drawn, 150).faces) <= 150
    _, _, fine = panels(drawn, 2400)
    assert len(fine.faces) <= 2400
    assert fine.volume == pytest.approx(drawn.volume, rel=0.01)
