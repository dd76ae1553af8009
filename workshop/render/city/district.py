"""A district in Blender: streets, houses, parks, cars, people, trees, wires, skyline."""

from __future__ import annotations

import itertools
from dataclasses import dataclass, field
from typing import Any

import bpy
import numpy as np
from numpy.typing import ArrayLike, NDArray

from workshop.render.city import buildings, nature, street, vehicles
from workshop.render.city.layout import (
    CORNER_RADIUS,
    HALF_STREET,
    KERB_HEIGHT,
    PARKING,
    Block,
    District,
    Lot,
    plan_district,
    split_lots,
)
from workshop.render.city.traffic import Traffic
from workshop.render.surfaces.materials import Materials
from workshop.render.surfaces.mesh_builder import Mesh

_CURB_STRIP = 0.6  # from the kerb to the middle of lamp posts and signs
_TREE_STRIP = 0.95


@dataclass
class Stage:
    """The Blender scene under construction: where objects and shared meshes are kept."""

    materials: Materials = field(default_factory=Materials)
    shared: dict[str, Any] = field(default_factory=dict)

    def add(self, mesh: Mesh, name: str, color: ArrayLike = (0.5, 0.5, 0.5)) -> Any:
        """Add a mesh that is used once, in world coordinates."""
        return self.put(mesh.to_blender(name, self.materials), (0, 0, 0), 0.0, color)

    def share(self, name: str, mesh: Mesh, smooth: bool = True) -> None:
        """Keep a mesh for repeated use under `name`."""
        self.shared[name] = mesh.to_blender(name, self.materials, smooth)

    def put(
        self,
        mesh: Any,
        at: ArrayLike,
        yaw: float = 0.0,
        color: ArrayLike = (0.5, 0.5, 0.5),
        scale: float = 1.0,
    ) -> Any:
        """Place an object with a shared mesh (its name) or a Blender mesh."""
        data = self.shared[mesh] if isinstance(mesh, str) else mesh
        item = bpy.data.objects.new(data.name, data)
        item.location, item.rotation_euler = at, (0.0, 0.0, yaw)
        item.scale, item.color = (scale,) * 3, (*color, 1.0)
        bpy.context.scene.collection.objects.link(item)
        return item


def build_city(seed: int) -> tuple[District, Traffic]:
    """Fill the current Blender scene with a district; the same city for the same seed."""
    district, stage = plan_district(seed), Stage()
    _share_models(stage, np.random.default_rng([seed, 3]))
    stage.add(street.ground(district), "carriageway")
    for block in district.blocks:
        rng = np.random.default_rng([seed, 4, block.number])
        stage.add(street.pavement(block, rng), "pavement")
        if block.kind == "park":
            _park(stage, block, rng)
        else:
            for lot in split_lots(block, rng):
                _lot(stage, lot, rng)
        for side, (start, along, length) in enumerate(block.kerb.sides()):
            _roadside(stage, block, Side(start, along, length, side), rng)
    _skyline(stage, district, np.random.default_rng([seed, 5]))
    return district, Traffic(district, stage)


def _share_models(stage: Stage, rng: np.random.Generator) -> None:
    for kind in vehicles.BODIES:
        stage.share(kind, vehicles.car(kind))
    for k in range(6):
        stage.share(f"tree{k}", nature.tree(rng, rng.uniform(5.4, 7.2), rng.uniform(1.45, 1.75)))
        stage.share(f"big tree{k}", nature.tree(rng, rng.uniform(8, 12), rng.uniform(2.6, 3.6)))
    for k in range(12):
        stage.share(f"person{k}", nature.person(rng, walking=k % 3 > 0))
    for k in range(4):
        stage.share(f"sign{k}", street.sign(k), smooth=False)
    stage.share("planter", street.planter(rng))
    for name, model in street.MODELS.items():
        stage.share(name, model())


@dataclass(frozen=True)
class Side:
    """One side of a block: where its kerb starts, which way it runs, how long it is."""

    start: NDArray[np.float64]
    along: NDArray[np.float64]
    length: float
    number: int

    @property
    def outward(self) -> NDArray[np.float64]:
        """Unit vector towards the carriageway."""
        return np.array([self.along[1], -self.along[0]])

    @property
    def yaw(self) -> float:
        """Turn that points an object's +x to the carriageway."""
        return float(np.arctan2(self.outward[1], self.outward[0]))

    def at(self, s: float, inside: float, z: float = KERB_HEIGHT) -> tuple[float, float, float]:
        """Return the point `s` along the kerb and `inside` metres behind it."""
        return (*(self.start + s * self.along - inside * self.outward), z)


def _lot(stage: Stage, lot: Lot, rng: np.random.Generator) -> None:
    if not lot.empty:
        mesh, color = buildings.build(lot, rng)
        stage.add(mesh, "building", color)
        return
    mesh, g = Mesh(), lot.ground
    z = KERB_HEIGHT + 0.012
    mesh.floor((g.x0, g.y0), (g.x1, g.y1), z, "grass")
    y = g.y0 + 0.3 if lot.street_sides[0] else g.y1 - 0.3
    posts = np.arange(g.x0 + 0.1, g.x1, 0.16)
    mesh.box((posts, y, z), (posts + 0.025, y + 0.025, z + 1.5), "dark_trim")
    rails = z + np.array([0.2, 1.35])
    mesh.box((g.x0, y - 0.02, rails), (g.x1, y + 0.04, rails + 0.05), "dark_trim")
    stage.add(mesh, "garden")
    for x in np.arange(g.x0 + 3.8, g.x1 - 3.6, 5.5):
        name, at = f"big tree{rng.integers(6)}", (x, g.center[1] + rng.uniform(-1.5, 1.5), z)
        stage.put(name, at, rng.uniform(0, 6.28), scale=0.9)


def _park(stage: Stage, block: Block, rng: np.random.Generator) -> None:
    area, mesh, z = block.building_line, Mesh(), KERB_HEIGHT + 0.03
    mesh.prism(area.rounded(3.0), 0.0, z, "kerbstone", "grass")
    middle, (w, h) = area.center, area.size
    (x, y), low, high = middle, z - 0.05, z + 0.01
    mesh.box((area.x0, y - 1.2, low), (area.x1, y + 1.2, high), "cobbles")
    mesh.box((x - 1.2, area.y0, low), (x + 1.2, area.y1, high), "cobbles")
    stage.add(mesh, "park")
    for k in range(26):
        x, y = area.x0 + 3.8 + (w - 7.6) * rng.random(), area.y0 + 3.8 + (h - 7.6) * rng.random()
        if min(abs(x - middle[0]), abs(y - middle[1])) > 2.2:
            yaw, scale = rng.uniform(0, 6.28), rng.uniform(0.75, 1.1)
            stage.put(f"big tree{k % 6}", (x, y, z), yaw, scale=scale)
    for side in (-1, 1):
        for x in np.arange(area.x0 + 6, area.x1 - 6, 9):
            if abs(x - middle[0]) > 3:
                yaw, lamp = -side * np.pi / 2, (x + 3.5, middle[1] + side * 1.6, z)
                stage.put("bench", (x, middle[1] + side * 1.75, z), yaw)
                stage.put("lamp", lamp, yaw, scale=0.55)
    for start, along, length in area.inset(0.6).sides():
        for s in (3.0, length / 2 + 2.5):
            run = nature.hedge(length / 2 - 6.0, rng).to_blender("hedge", stage.materials)
            stage.put(run, (*(start + along * s), z), np.arctan2(along[1], along[0]))


def _roadside(stage: Stage, block: Block, side: Side, rng: np.random.Generator) -> None:
    """Furnish one side of a block: cars, masts, trees or poles with wires, people."""
    _parked_cars(stage, side, rng)
    first, last = CORNER_RADIUS + 1.2, side.length - CORNER_RADIUS - 1.2
    stage.put("light", side.at(first, _CURB_STRIP), side.yaw)
    stage.put("sign3", side.at(last + 0.4, _CURB_STRIP), side.yaw)
    spots = np.arange(first + 2.6, last - 2.0, 3.1)
    free = list(range(len(spots)))
    for k in free[2::8]:
        stage.put("lamp", side.at(spots[k], _CURB_STRIP), side.yaw)
    free = [k for k in free if k % 8 != 2]
    wired = rng.random() < 0.3 and block.kind == "houses"
    for k in free[1::7] if wired else []:
        stage.put("pole", side.at(spots[k], _CURB_STRIP), side.yaw)
    if wired:
        _wires(stage, side, spots[free[1::7]], rng)
    small = ["sign0", "sign1", "sign2", "bin", "hydrant", "bicycle"]
    small += ["planter", "bollard", "bench", "kiosk", "shelter"]
    weights = np.array([1, 1, 1.2, 2.2, 0.7, 2.5, 1.5, 1.2, 1.2, 0.45, 0.5])
    for n, k in enumerate(free):
        if wired and n % 7 == 1:
            continue
        if not wired and rng.random() < 0.42:
            _tree(stage, side, spots[k], rng)
        elif rng.random() < 0.75:
            name = str(rng.choice(small, p=weights / weights.sum()))
            _small_thing(stage, side, spots[k], name, rng)
    _people(stage, block, side, rng)


def _small_thing(stage: Stage, side: Side, s: float, name: str, rng: np.random.Generator) -> None:
    wide = {"kiosk": 1.1, "shelter": 1.2, "planter": 0.8, "bollard": 0.35, "bench": 0.8}
    inside = wide.get(name, _CURB_STRIP)
    turn = np.pi if name == "bench" and rng.random() < 0.5 else 0.0
    stage.put(name, side.at(s, inside), side.yaw + turn, rng.uniform(0.05, 0.6, 3))


def _tree(stage: Stage, side: Side, s: float, rng: np.random.Generator) -> None:
    pit, (x, y, z) = Mesh(), side.at(s, _TREE_STRIP, KERB_HEIGHT + 0.008)
    corners = (-0.6, -0.6), (0.6, -0.6), (0.6, 0.6), (-0.6, 0.6)
    pit.add([(x + a, y + b, z) for a, b in corners], "soil")
    stage.add(pit, "tree pit")
    name, yaw, scale = f"tree{rng.integers(6)}", rng.uniform(0, 6.28), rng.uniform(0.9, 1.05)
    stage.put(name, (x, y, KERB_HEIGHT), yaw, scale=scale)


def _wires(stage: Stage, side: Side, at: NDArray[np.float64], rng: np.random.Generator) -> None:
    for a, b in itertools.pairwise(at):
        for x, z in street.WIRE_SPOTS:
            ends = (np.array(side.at(s, _CURB_STRIP - x, KERB_HEIGHT + z)) for s in (a, b))
            stage.add(street.wire(*ends, rng.uniform(0.25, 0.45)), "wire")


def _parked_cars(stage: Stage, side: Side, rng: np.random.Generator) -> None:
    slots = street.parking_slots(CORNER_RADIUS, side.length - CORNER_RADIUS)
    forward = side.along.sum() > 0
    for slot in slots[rng.random(len(slots)) < 0.72]:
        s = slot if forward else side.length - slot
        kind = str(rng.choice(list(vehicles.BODIES), p=[0.26, 0.28, 0.18, 0.18, 0.1]))
        s += rng.uniform(-0.15, 0.15)
        at = side.at(s, PARKING - HALF_STREET + rng.uniform(-0.06, 0.06), 0.0)
        heading = np.arctan2(-side.along[1], -side.along[0]) + np.pi * (rng.random() < 0.08)
        heading += rng.normal(0, 0.012)
        stage.put(kind, at, heading, vehicles.PAINTS[rng.integers(len(vehicles.PAINTS))])


def _people(stage: Stage, block: Block, side: Side, rng: np.random.Generator) -> None:
    for s in np.arange(CORNER_RADIUS + 2, side.length - CORNER_RADIUS - 2, 2.2):
        if rng.random() < 0.2:
            at = side.at(s + rng.uniform(-0.5, 0.5), rng.uniform(2.25, block.pavement - 0.95))
            name, turn = f"person{rng.integers(12)}", np.pi / 2 * rng.choice([-1, 1])
            stage.put(name, at, side.yaw + turn + rng.normal(0, 0.3))


def _skyline(stage: Stage, district: District, rng: np.random.Generator) -> None:
    """Ring the district with far, simple towers, so that every street ends in a city."""
    e, mesh = district.extent, Mesh()
    reach = np.array(e.size) / 2
    for ring, (height, wide) in enumerate(((22, 17), (34, 24), (48, 32), (65, 40))):
        away = 16 + 55 * ring
        for side in range(4):
            half = reach[side % 2] + away + 40
            for s in np.arange(-half, half, wide * 1.18):
                across = reach[1 - side % 2] + away + rng.uniform(0, 18)
                center = e.center + ((s, across), (across, s), (s, -across), (-across, s))[side]
                size = np.array([wide, wide]) / 2 * rng.uniform(0.8, 1.05)
                top = height * rng.uniform(0.5, 1.4)
                mesh.box((*(center - size), 0), (*(center + size), top), "skyline")
    stage.add(mesh, "skyline", (0.32, 0.29, 0.27))
