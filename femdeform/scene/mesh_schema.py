"""Where a body's mesh comes from: a recipe of `meshes.recipes`, or a file.

`MeshSource` is the union of all. Sides are named the same everywhere: `left`/`right` are the ends in x,
`bottom`/`top` in y, `back`/`front` in z; what is not flat is named for what it is (`side`, `hole`, ...).
"""

from __future__ import annotations

import math
from typing import Annotated, Any, Literal, get_args

from pydantic import BaseModel, BeforeValidator, ConfigDict, Discriminator, Field, Tag, model_validator


class MeshModel(BaseModel):
    """Base of every mesh block: unknown keys are errors, types are not coerced, objects are frozen."""

    model_config = ConfigDict(extra="forbid", strict=True, frozen=True)


def _as_tuple(value: Any) -> Any:
    # YAML knows lists only; strict tuples would refuse them.
    return tuple(value) if isinstance(value, list) else value


# Far outside of any body, and far inside of what products of three lengths can hold.
_LARGEST = 1e12

_Finite = Annotated[float, Field(ge=-_LARGEST, le=_LARGEST, allow_inf_nan=False)]
_Positive = Annotated[float, Field(gt=0.0, le=_LARGEST, allow_inf_nan=False)]
_NonNegative = Annotated[float, Field(ge=0.0, le=_LARGEST, allow_inf_nan=False)]
_Count = Annotated[int, Field(ge=1, le=100_000)]

_Vector = Annotated[tuple[_Finite, ...], BeforeValidator(_as_tuple), Field(min_length=2, max_length=3)]
_Point2 = Annotated[tuple[_Finite, _Finite], BeforeValidator(_as_tuple)]
_Vector3 = Annotated[tuple[_Finite, _Finite, _Finite], BeforeValidator(_as_tuple)]
_Sizes = Annotated[tuple[_Positive, ...], BeforeValidator(_as_tuple), Field(min_length=1, max_length=3)]
_Sizes2 = Annotated[tuple[_Positive, _Positive], BeforeValidator(_as_tuple)]
_Sizes3 = Annotated[tuple[_Positive, _Positive, _Positive], BeforeValidator(_as_tuple)]
_Counts = Annotated[tuple[_Count, ...], BeforeValidator(_as_tuple), Field(min_length=1, max_length=3)]
_Counts2 = Annotated[tuple[_Count, _Count], BeforeValidator(_as_tuple)]

# More cells than this is a slip of the pen, not a mesh: it would fill the memory before anything is said.
MAX_STRUCTURED_CELLS = 5_000_000

Diagonals = Literal["alternating", "right", "left"]
_DIAGONALS = "diagonals of the cells: alternating, or all rising to the `right` or the `left`"


def _check_cell_count(counts: tuple[int, ...]) -> None:
    total = 1
    for count in counts:
        total *= count
    if total > MAX_STRUCTURED_CELLS:
        raise ValueError(f"cells: {total} cells are too many (at most {MAX_STRUCTURED_CELLS})")


def _check_resolved(key: str, radius: float, element_size: float) -> None:
    # Much coarser elements cannot follow the curvature: the mesh generator tries for ever, or fails obscurely.
    if element_size > 20.0 * radius:
        raise ValueError(f"{key}: element_size {element_size:g} is too coarse for it (at most {20.0 * radius:g})")


class Rotation(MeshModel):
    """A rotation about an axis through the origin, or about the origin in 2D."""

    axis: _Vector3 = Field(default=(0.0, 0.0, 1.0), description="axis of rotation [-]; in 2D always z")
    angle: _Finite = Field(description="angle, right-handed about `axis` [rad]")

    @model_validator(mode="after")
    def _has_direction(self) -> Rotation:
        if not any(self.axis):
            raise ValueError("axis: a zero vector has no direction")
        return self


class PlacedMesh(MeshModel):
    """What every source can do: turn and shift the body, in this order."""

    rotate: Rotation | None = Field(default=None, description="rotation of the mesh, before `translate`")
    translate: _Vector | None = Field(default=None, description="shift of the finished mesh [m]")


# ------------------------------------------------------------------------------------- structured recipes


class BlockMesh(PlacedMesh):
    """A box with one corner in the origin, cut into cells; a rectangle or a line with fewer sizes."""

    recipe: Literal["block"] = Field(description="structured box (3 sizes), rectangle (2) or line (1)")
    size: _Sizes = Field(default=(1.0, 1.0, 1.0), description="edge lengths in x, y, z [m]")
    cells: _Counts = Field(default=(8, 8, 8), description="cells along each edge")
    split: Literal[5, 6] = Field(
        default=5, description="tetrahedra of a cell: 5, mirrored from cell to cell, or 6 around one diagonal"
    )
    diagonals: Diagonals = Field(default="alternating", description=_DIAGONALS)
    dim: Literal[2, 3] | None = Field(
        default=None, description="dimension of the space; default 2 for a rectangle, else 3"
    )

    @model_validator(mode="after")
    def _consistent(self) -> BlockMesh:
        if len(self.size) != len(self.cells):
            raise ValueError(f"size has {len(self.size)} entries but cells has {len(self.cells)}")
        if self.dim is not None and self.dim < len(self.size):
            raise ValueError(f"dim: {len(self.size)} sizes do not fit into {self.dim} dimensions")
        _check_cell_count(self.cells)
        return self


class MuscleMesh(PlacedMesh):
    """A spindle of muscle along x between two bones; the muscle reaches from x = 0 to its length.

    Cell groups: `muscle`, of which `belly` and `tendons` are parts, these in turn `origin_tendon` and
    `insertion_tendon`; `origin_bone` (x < 0) and `insertion_bone`.
    """

    recipe: Literal["muscle"] = Field(description="spindle-shaped muscle between two bones, structured")
    length: _Positive = Field(default=0.2, description="length of the muscle with its tendons [m]")
    radius: _Positive = Field(default=0.025, description="radius of the belly in the middle [m]")
    end_radius: _Positive = Field(default=0.01, description="radius of the tendons [m]")
    tendon_length: _NonNegative = Field(default=0.03, description="length of each tendon [m]")
    bone_length: _Positive = Field(default=0.02, description="length of each bone [m]")
    bone_radius: _Positive = Field(default=0.015, description="radius of the bones away from the muscle [m]")
    cells: _Counts2 = Field(default=(24, 6), description="cells along the muscle and across")
    split: Literal[5, 6] = Field(default=5, description="tetrahedra of a cell, as in `block`")

    @model_validator(mode="after")
    def _consistent(self) -> MuscleMesh:
        if 2.0 * self.tendon_length >= self.length:
            raise ValueError("tendon_length: two of them must be shorter than the muscle")
        _check_cell_count((2 * self.cells[0], self.cells[1], self.cells[1]))
        return self


class ClothMesh(PlacedMesh):
    """A flat rectangle of triangles in 3D, centred in the origin."""

    recipe: Literal["cloth"] = Field(description="structured rectangle of triangles in 3D")
    size: _Sizes2 = Field(default=(1.0, 1.0), description="edge lengths [m]")
    cells: _Counts2 = Field(default=(20, 20), description="cells along each edge, two triangles each")
    plane: Literal["xz", "xy"] = Field(
        default="xz",
        description="xz: lying, edges left/right/back/front; xy: standing, edges left/right/bottom/top",
    )
    diagonals: Diagonals = Field(default="alternating", description=_DIAGONALS)

    @model_validator(mode="after")
    def _consistent(self) -> ClothMesh:
        _check_cell_count(self.cells)
        return self


class SphereSurfaceMesh(PlacedMesh):
    """A closed sphere of nearly equal triangles in 3D (a subdivided icosahedron), centred in the origin."""

    recipe: Literal["sphere_surface"] = Field(description="closed sphere of triangles; poles named")
    radius: _Positive = Field(default=0.5, description="radius [m]")
    element_size: _Positive = Field(default=0.1, description="edge length aimed at [m]")

    @model_validator(mode="after")
    def _consistent(self) -> SphereSurfaceMesh:
        if self.radius / self.element_size > 300.0:
            raise ValueError("element_size: more than 300 elements along the radius")
        return self


class RodMesh(PlacedMesh):
    """A straight rod of line cells in 3D."""

    recipe: Literal["rod"] = Field(description="straight rod of line cells; ends named `start` and `end`")
    start: _Vector3 = Field(default=(0.0, 0.0, 0.0), description="first end [m]")
    end: _Vector3 = Field(default=(1.0, 0.0, 0.0), description="second end [m]")
    cells: Annotated[int, Field(ge=1, le=MAX_STRUCTURED_CELLS)] = Field(default=20, description="line cells")

    @model_validator(mode="after")
    def _consistent(self) -> RodMesh:
        if self.start == self.end:
            raise ValueError("end: start and end coincide")
        return self


class RodNetMesh(PlacedMesh):
    """A rectangular net of rods in 3D, centred in the origin."""

    recipe: Literal["rod_net"] = Field(description="rectangular net of line cells; edges and corners named")
    size: _Sizes2 = Field(default=(1.0, 1.0), description="edge lengths [m]")
    meshes: _Counts2 = Field(default=(10, 10), description="openings along each edge")
    segments: _Count = Field(default=1, description="line cells between two crossings")
    plane: Literal["xz", "xy"] = Field(
        default="xz",
        description="xz: lying, edges left/right/back/front; xy: standing, edges left/right/bottom/top",
    )

    @model_validator(mode="after")
    def _consistent(self) -> RodNetMesh:
        _check_cell_count((*self.meshes, self.segments))
        return self


class CookMesh(PlacedMesh):
    """Cook's panel: a tapered, swept plate clamped on its left and sheared on its right edge."""

    recipe: Literal["cook"] = Field(description="Cook's tapered panel, structured")
    length: _Positive = Field(default=48.0, description="extent in x [m]")
    left_height: _Positive = Field(default=44.0, description="height of the left edge [m]")
    right_height: _Positive = Field(default=16.0, description="height of the right edge [m]")
    rise: _Finite = Field(default=44.0, description="lower right corner over the lower left one, in y [m]")
    thickness: _Positive | None = Field(default=None, description="extent in z [m]; without: triangles in 2D")
    cells: _Counts = Field(default=(16, 16), description="cells in x and y, and in z with a thickness")
    split: Literal[5, 6] = Field(default=5, description="tetrahedra of a cell, with a thickness")
    diagonals: Diagonals = Field(default="alternating", description=_DIAGONALS)

    @model_validator(mode="after")
    def _consistent(self) -> CookMesh:
        wanted = 2 if self.thickness is None else 3
        if len(self.cells) != wanted:
            raise ValueError(f"cells: {wanted} entries are needed, not {len(self.cells)}")
        _check_cell_count(self.cells)
        return self


class FlagMesh(PlacedMesh):
    """The elastic bar behind a cylinder, of the Turek-Hron benchmark; its left end fits the cylinder."""

    recipe: Literal["flag"] = Field(description="bar behind a cylinder (Turek and Hron), triangles in 2D")
    center: _Point2 = Field(default=(0.2, 0.2), description="centre of the cylinder [m]")
    radius: _Positive = Field(default=0.05, description="radius of the cylinder [m]")
    length: _Positive = Field(default=0.35, description="from cylinder to free end, on the mid line [m]")
    thickness: _Positive = Field(default=0.02, description="height of the bar [m]")
    cells: _Counts2 = Field(default=(70, 4), description="cells along and across; an even number across")
    diagonals: Diagonals = Field(default="alternating", description=_DIAGONALS)

    @model_validator(mode="after")
    def _consistent(self) -> FlagMesh:
        if self.thickness >= 2.0 * self.radius:
            raise ValueError("thickness: the bar must be thinner than the cylinder")
        if self.cells[1] % 2:
            raise ValueError("cells: an even number across is needed for a node at the tip")
        _check_cell_count(self.cells)
        return self


class RingMesh(PlacedMesh):
    """A sector of a ring about the origin, from the positive x axis on; with a thickness a sector of a tube."""

    recipe: Literal["ring"] = Field(
        description="structured sector of a ring or tube; `inner`, `outer`, `start`, `end`, and `back`, `front`"
    )
    inner_radius: _Positive = Field(default=0.5, description="inner radius [m]")
    outer_radius: _Positive = Field(default=1.0, description="outer radius [m]")
    angle: Annotated[float, Field(gt=0.0, lt=2.0 * math.pi)] = Field(
        default=0.5 * math.pi, description="angle of the sector, counter-clockwise from the x axis [rad]"
    )
    thickness: _Positive | None = Field(default=None, description="extent in z [m]; without: triangles in 2D")
    cells: _Counts = Field(default=(8, 16), description="cells along the radius and around, and in z with a thickness")
    split: Literal[5, 6] = Field(default=5, description="tetrahedra of a cell, with a thickness")
    diagonals: Diagonals = Field(default="alternating", description=_DIAGONALS)

    @model_validator(mode="after")
    def _consistent(self) -> RingMesh:
        if self.outer_radius <= self.inner_radius:
            raise ValueError("outer_radius: must be larger than inner_radius")
        wanted = 2 if self.thickness is None else 3
        if len(self.cells) != wanted:
            raise ValueError(f"cells: {wanted} entries are needed, not {len(self.cells)}")
        if self.angle > 0.5001 * math.pi * self.cells[1]:
            raise ValueError("cells: too few around; a cell may span a quarter of a turn at most")
        _check_cell_count(self.cells)
        return self


# ----------------------------------------------------------------------------------- unstructured recipes


class BeamMesh(PlacedMesh):
    """A box with one corner in the origin, like `block`, with unstructured tetrahedra."""

    recipe: Literal["beam"] = Field(description="box of unstructured tetrahedra, sides named as in `block`")
    size: _Sizes3 = Field(default=(1.0, 0.2, 0.2), description="edge lengths in x, y, z [m]")
    element_size: _Positive = Field(default=0.05, description="edge length aimed at [m]")

    @model_validator(mode="after")
    def _consistent(self) -> BeamMesh:
        _check_resolved("size", min(self.size), self.element_size)
        return self


class CylinderMesh(PlacedMesh):
    """A cylinder or tube; one end face is centred in the origin."""

    recipe: Literal["cylinder"] = Field(description="cylinder or tube; its ends, `side` and `hole`")
    radius: _Positive = Field(default=0.5, description="outer radius [m]")
    hole_radius: _NonNegative = Field(default=0.0, description="radius of the bore, 0 for none [m]")
    length: _Positive = Field(default=1.0, description="length along the axis [m]")
    axis: Literal["x", "y", "z"] = Field(default="y", description="axis; the ends are named after it")
    element_size: _Positive = Field(default=0.15, description="edge length aimed at [m]")

    @model_validator(mode="after")
    def _consistent(self) -> CylinderMesh:
        if self.hole_radius >= self.radius:
            raise ValueError("hole_radius: must be smaller than radius")
        _check_resolved("radius", self.radius, self.element_size)
        if self.hole_radius > 0.0:
            thinnest = min(self.hole_radius, self.radius - self.hole_radius)
            _check_resolved("hole_radius", thinnest, self.element_size)
        return self


class SphereMesh(PlacedMesh):
    """A solid ball centred in the origin."""

    recipe: Literal["sphere"] = Field(description="solid ball; boundary named `surface`")
    radius: _Positive = Field(default=0.5, description="radius [m]")
    element_size: _Positive = Field(default=0.15, description="edge length aimed at [m]")

    @model_validator(mode="after")
    def _consistent(self) -> SphereMesh:
        _check_resolved("radius", self.radius, self.element_size)
        return self


class EllipsoidMesh(PlacedMesh):
    """A solid ellipsoid centred in the origin."""

    recipe: Literal["ellipsoid"] = Field(description="solid ellipsoid; boundary named `surface`")
    semi_axes: _Sizes3 = Field(default=(1.0, 0.5, 0.5), description="half lengths in x, y, z [m]")
    element_size: _Positive = Field(default=0.15, description="edge length aimed at [m]")

    @model_validator(mode="after")
    def _consistent(self) -> EllipsoidMesh:
        _check_resolved("semi_axes", 0.1 * min(self.semi_axes), self.element_size)
        return self


class TorusMesh(PlacedMesh):
    """A solid ring about the y axis, centred in the origin."""

    recipe: Literal["torus"] = Field(description="solid ring about the y axis; boundary named `surface`")
    radius: _Positive = Field(default=0.5, description="from the centre to the middle of the tube [m]")
    tube_radius: _Positive = Field(default=0.2, description="radius of the tube [m]")
    element_size: _Positive = Field(default=0.1, description="edge length aimed at [m]")

    @model_validator(mode="after")
    def _consistent(self) -> TorusMesh:
        if self.tube_radius >= self.radius:
            raise ValueError("tube_radius: must be smaller than radius")
        _check_resolved("tube_radius", self.tube_radius, self.element_size)
        return self


class SphericalShellMesh(PlacedMesh):
    """A thick spherical shell centred in the origin, or a part of it cut at the coordinate planes."""

    recipe: Literal["spherical_shell"] = Field(description="thick shell of a sphere; `outer`, `inner`, cuts")
    radius: _Positive = Field(default=0.5, description="outer radius [m]")
    thickness: _Positive = Field(default=0.1, description="thickness of the wall [m]")
    part: Literal["full", "half", "eighth"] = Field(
        default="full",
        description="half: y >= 0, cut named `bottom`; eighth: x, y, z >= 0, cuts `left`, `bottom`, `back`",
    )
    element_size: _Positive = Field(default=0.08, description="edge length aimed at [m]")

    @model_validator(mode="after")
    def _consistent(self) -> SphericalShellMesh:
        if self.thickness >= self.radius:
            raise ValueError("thickness: must be smaller than radius")
        _check_resolved("thickness", min(self.thickness, self.radius - self.thickness), self.element_size)
        return self


class PlateWithHoleMesh(PlacedMesh):
    """A rectangular plate with a circular hole in its centre, the origin."""

    recipe: Literal["plate_with_hole"] = Field(description="plate with a hole; sides and `hole`")
    size: _Sizes2 = Field(default=(2.0, 2.0), description="edge lengths of the whole plate in x, y [m]")
    radius: _Positive = Field(default=0.25, description="radius of the hole [m]")
    thickness: _Positive | None = Field(default=None, description="extent in z [m]; without: triangles in 2D")
    quarter: bool = Field(default=False, description="true: x, y >= 0 only; the cuts are `left` and `bottom`")
    element_size: _Positive = Field(default=0.1, description="edge length aimed at, away from the hole [m]")
    hole_element_size: _Positive | None = Field(
        default=None, description="edge length aimed at around the hole [m]; default element_size / 2"
    )

    @model_validator(mode="after")
    def _consistent(self) -> PlateWithHoleMesh:
        if 2.0 * self.radius >= min(self.size):
            raise ValueError("radius: the hole does not fit into the plate")
        _check_resolved("radius", self.radius, self.element_size)
        if self.thickness is not None:
            _check_resolved("thickness", self.thickness, self.element_size)
        if self.hole_element_size is not None and self.hole_element_size < 0.01 * self.element_size:
            raise ValueError("hole_element_size: less than a hundredth of element_size")
        return self


class RubberMountMesh(PlacedMesh):
    """A vibration mount: a round rubber body, waisted or bulged, bonded between two square steel plates.

    It stands on the plane y = 0 and its axis is the y axis. The three parts share the nodes of the bonds.
    """

    recipe: Literal["rubber_mount"] = Field(
        description="rubber body between bonded plates; cells `rubber`, `bottom_plate`, `top_plate`"
    )
    rubber_height: _Positive = Field(default=0.05, description="height of the rubber [m]")
    bottom_radius: _Positive = Field(default=0.035, description="rubber's radius at the bottom plate [m]")
    top_radius: _Positive = Field(default=0.03, description="rubber's radius at the top plate [m]")
    waist_radius: _Positive = Field(
        default=0.026, description="radius at half height; its profile is an arc through all three [m]"
    )
    bore_radius: _NonNegative = Field(
        default=0.008, description="radius of the bore through rubber and plates, 0 for none [m]"
    )
    plate_size: _Positive = Field(default=0.09, description="edge length of the square plates [m]")
    plate_thickness: _Positive = Field(default=0.006, description="thickness of the plates [m]")
    bolt_hole_radius: _NonNegative = Field(
        default=0.0045, description="radius of the four bolt holes of each plate, 0 for none [m]"
    )
    bolt_hole_inset: _Positive = Field(default=0.01, description="from a bolt hole's centre to the edges [m]")
    element_size: _Positive = Field(default=0.005, description="edge length aimed at in the rubber [m]")
    plate_element_size: _Positive | None = Field(
        default=None, description="edge length aimed at in the plates [m]; default 2 element_size"
    )

    @model_validator(mode="after")
    def _consistent(self) -> RubberMountMesh:
        coarse = max(self.element_size, self.plate_element_size or 2.0 * self.element_size)
        for key in ("rubber_height", "plate_thickness", "bore_radius", "bolt_hole_radius", "waist_radius"):
            length = getattr(self, key)
            if length > 0.0:
                _check_resolved(key, length, coarse)
        narrowest = min(self.bottom_radius, self.top_radius, self.waist_radius)
        if self.bore_radius >= narrowest:
            raise ValueError("bore_radius: the bore must be narrower than the rubber")
        half = 0.5 * self.plate_size
        if max(self.bottom_radius, self.top_radius) >= half:
            raise ValueError("plate_size: the plates must be wider than the rubber bonded to them")
        if self.bolt_hole_radius > 0.0:
            if self.bolt_hole_inset <= self.bolt_hole_radius:
                raise ValueError("bolt_hole_inset: the bolt holes cut through the plates' edges")
            reach = 2.0**0.5 * (half - self.bolt_hole_inset) - self.bolt_hole_radius
            if half <= self.bolt_hole_inset or reach <= max(self.bottom_radius, self.top_radius):
                raise ValueError("bolt_hole_inset: the bolt holes run into the rubber")
        return self


# -------------------------------------------------------------------------------------------------- files


class FileMesh(MeshModel):
    """A mesh, a surface or a CAD solid from a file; scaled, turned and shifted in this order."""

    file: str = Field(
        min_length=1,
        description="path, relative to the scene: .msh .mesh .vtk .vtu .obj .stl .ply .npz .step .stp",
    )
    scale: _Positive = Field(default=1.0, description="factor on the coordinates, to get metres [-]")
    rotate: Rotation | None = Field(default=None, description="rotation after `scale`, before `translate`")
    translate: _Vector | None = Field(default=None, description="shift after `scale` and `rotate` [m]")
    fill: bool = Field(default=False, description="true: fill a closed triangle surface with tetrahedra")
    element_size: _Positive | None = Field(
        default=None,
        description="edge length aimed at, after `scale` [m]; for STEP solids (default: 1/20 of diagonal) "
        "and filled surfaces (default: their own triangles are kept)",
    )
    cell_type: Literal["line", "triangle", "tetra", "surface", "edges"] | None = Field(
        default=None,
        description="cells to take: the file's lines, triangles or tetrahedra, or the boundary `surface` of "
        "its tetrahedra, or all `edges` of its cells as rods; default: cells of the highest dimension",
    )
    dim: Literal[2, 3] | None = Field(
        default=None, description="2: drop the constant z of a flat mesh; default as in the file"
    )
    drop_unreferenced: bool = Field(
        default=False, description="true: remove points that no cell uses; false: they are an error"
    )

    @model_validator(mode="after")
    def _consistent(self) -> FileMesh:
        step = self.file.lower().endswith((".step", ".stp"))
        if self.fill and step:
            raise ValueError("fill: a STEP solid is filled anyway")
        if self.element_size is not None and not (self.fill or step):
            raise ValueError("element_size: only for STEP solids, and for surfaces with `fill: true`")
        if self.fill and self.cell_type not in (None, "tetra"):
            raise ValueError("cell_type: a filled surface has tetrahedra")
        return self


Recipe = (
    BlockMesh
    | MuscleMesh
    | ClothMesh
    | SphereSurfaceMesh
    | RodMesh
    | RodNetMesh
    | CookMesh
    | FlagMesh
    | RingMesh
    | BeamMesh
    | CylinderMesh
    | SphereMesh
    | EllipsoidMesh
    | TorusMesh
    | SphericalShellMesh
    | PlateWithHoleMesh
    | RubberMountMesh
)

RECIPE_NAMES: tuple[str, ...] = tuple(
    get_args(model.model_fields["recipe"].annotation)[0] for model in get_args(Recipe)
)

# Not the bare word `file`: the tag appears in the location of an error and must not be mistaken for the key.
_FILE_TAG = "(file)"


def recipe(value: Any) -> str | None:
    """Tag of the member of `MeshSource` that a value is meant for: the recipe's name, or that of a file.

    The function's name is part of the error for an unknown tag, where it stands for the key it looks at.
    """
    if isinstance(value, dict):
        if "recipe" in value:
            return str(value["recipe"])
        return _FILE_TAG if "file" in value else None
    if isinstance(value, FileMesh):
        return _FILE_TAG
    name = getattr(value, "recipe", None)
    return name if isinstance(name, str) else None


def _has_source(value: Any) -> Any:
    # Said here because the error of a union without a tag names neither key.
    if recipe(value) is None:
        raise ValueError("a mesh is either {recipe: NAME, ...} or {file: PATH, ...}")
    return value


MeshSource = Annotated[
    Annotated[
        Annotated[BlockMesh, Tag("block")]
        | Annotated[MuscleMesh, Tag("muscle")]
        | Annotated[ClothMesh, Tag("cloth")]
        | Annotated[SphereSurfaceMesh, Tag("sphere_surface")]
        | Annotated[RodMesh, Tag("rod")]
        | Annotated[RodNetMesh, Tag("rod_net")]
        | Annotated[CookMesh, Tag("cook")]
        | Annotated[FlagMesh, Tag("flag")]
        | Annotated[RingMesh, Tag("ring")]
        | Annotated[BeamMesh, Tag("beam")]
        | Annotated[CylinderMesh, Tag("cylinder")]
        | Annotated[SphereMesh, Tag("sphere")]
        | Annotated[EllipsoidMesh, Tag("ellipsoid")]
        | Annotated[TorusMesh, Tag("torus")]
        | Annotated[SphericalShellMesh, Tag("spherical_shell")]
        | Annotated[PlateWithHoleMesh, Tag("plate_with_hole")]
        | Annotated[RubberMountMesh, Tag("rubber_mount")]
        | Annotated[FileMesh, Tag(_FILE_TAG)],
        Discriminator(recipe),
    ],
    BeforeValidator(_has_source),
]
