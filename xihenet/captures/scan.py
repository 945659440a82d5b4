"""The scan of a recording: its surfaces as one mesh of all of its depth, coloured as it was seen.

Signed distances are averaged over the frames in voxels near surfaces (Curless and Levoy, 1996), and where they change
their sign lie the faces: one quad for each edge between two voxels, its corners in the middle of the crossings around
(naive surface nets, Gibson, 1998). Chosen because the mesh needs neither a table of cases nor closed cells: it ends
where nobody has looked. Rejected: averaged points that are meshed afterwards, which takes normals that noise turns.

Of a frame inverse depth is interpolated, since that is linear over a plane; pixels at the rim of something nearer, and
on surfaces that are seen at a grazing angle, are left out, and so are those of low confidence. Not here: closing holes,
and moving frames onto each other where poses drift.
"""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from xihenet.camera import valid_plane_depth
from xihenet.colour import LINEAR_OF_CODE
from xihenet.openings import joined
from xihenet.records import ArrayBool, ArrayF32, ArrayF64, ArrayInt, Intrinsics, RgbdFrame

SIDE = 8
"""Voxels along a block."""

NEAREST_M, FARTHEST_M = 0.1, 5.0
"""Of depths that are taken: a phone's range ends there."""

GRAZING = 0.15
"""Cosine between ray and normal below which a surface is seen too flatly: 81 degrees."""

RIM, CREASE = 0.02, 4.0
"""By so much inverse depth may bend between three pixels, relative: for noise, and CREASE / focal length besides for
the corner between two walls."""

MOST_PIXELS = 640 * 480
"""Of a frame; larger ones are thinned."""

MOST_ALLOCATING = 16_384
"""Pixels of a frame by which blocks are found."""

MOST_BLOCKS = 40_000
"""Half a gigabyte, and 160 square metres or more at 2 cm."""

SMALLEST_PIECE = 25
"""Faces; pieces with fewer are noise."""

BLOCKS_AT_ONCE = 64
"""What the passes over their voxels touch stays in the cache."""

REACH_VOXELS = 3.0
"""So far from a surface distances are averaged, on both sides."""

OFFSET = 0.37
"""Of voxels from multiples of their distance: on modelled walls, which like to lie at these, every distance would be 0,
and its sign that of an error of rounding."""

_BITS, _ZERO = 21, 1 << 20
"""Of each coordinate in a key, and what stands for 0."""


@dataclass(frozen=True, eq=False)
class ScanMesh:
    """Quads whose fronts show where the camera was.

    Parameters
    ----------
    points_m : (N, 3) float32, world, metres
    quads : (M, 4) int64, corners counterclockwise seen from the front
    colours : (N, 3) float32 linear, as exposed at the scan's exposure
    is_cut : whether there were more surfaces than memory is spent on
    """

    points_m: ArrayF32
    quads: ArrayInt
    colours: ArrayF32
    is_cut: bool = False


@dataclass(eq=False)
class Scan:
    """Surfaces that frames have shown so far, by voxels `voxel_m` apart; colours carry `exposure`."""

    exposure: float = 1.0
    voxel_m: float = 0.02
    is_cut: bool = False
    origin_m: ArrayF64 = field(default_factory=lambda: np.zeros(3))
    """(3,) world: amid the recording. Surfaces beyond some kilometres from there are left out."""
    _slots: dict[int, int] = field(default_factory=dict)
    """Place of a block in the arrays below, by its key."""
    _blocks: ArrayInt = field(default_factory=lambda: np.zeros((0, 3), np.int64))
    _distances: ArrayF32 = field(default_factory=lambda: np.zeros((0, SIDE**3), np.float32))
    """Metres, positive in front of a surface."""
    _weights: ArrayF32 = field(default_factory=lambda: np.zeros((0, SIDE**3), np.float32))
    _colours: ArrayF32 = field(default_factory=lambda: np.zeros((0, SIDE**3, 4), np.float32))
    """Weighted sums of linear light, and of weights."""

    @property
    def _reach_m(self) -> float:
        return self.voxel_m * REACH_VOXELS

    @property
    def _origin(self) -> ArrayInt:
        """(3,) the block from which all others are counted, so that keys hold them wherever a recording lies."""
        return np.floor(self.origin_m / (self.voxel_m * SIDE)).astype(np.int64)

    def add(self, frame: RgbdFrame) -> None:
        """Take in what one frame shows; nothing where it has no valid depth."""
        seen = _Seen.of(frame, self.exposure)
        slots = self._touched(seen)
        if not len(slots):
            return
        ends_m = seen.ends_m(self._reach_m)
        for start in range(0, len(slots), BLOCKS_AT_ONCE):
            part = slots[start : start + BLOCKS_AT_ONCE]
            corners_m = ((self._blocks[part] + self._origin) * SIDE + OFFSET) * self.voxel_m
            self._average(seen, part, corners_m, ends_m)

    def _average(self, seen: _Seen, slots: ArrayInt, corners_m: ArrayF64, ends_m: ArrayF32) -> None:
        """Take in what a frame shows of the blocks at these places, with these corners (K, 3)."""
        local = np.indices((SIDE, SIDE, SIDE)).reshape(3, -1)
        axes = seen.world_from_camera[:3, :3]
        corners = (axes.T @ (corners_m - seen.world_from_camera[:3, 3]).T).astype(np.float32)
        points = corners[:, :, None] + (axes.T @ local * self.voxel_m).astype(np.float32)[:, None]
        points = points.reshape(3, -1)
        voxels, distances_m, weights, pixels = seen.distances(points, self._reach_m, ends_m)
        voxels = slots[voxels // SIDE**3] * SIDE**3 + voxels % SIDE**3
        known, total = self._distances.reshape(-1), self._weights.reshape(-1)
        before, after = known[voxels], total[voxels] + weights
        known[voxels] = before + (distances_m - before) * weights / after
        total[voxels] = after
        near = np.flatnonzero(np.abs(distances_m) < self._reach_m)
        coloured = seen.light.take(pixels[near], axis=0)
        coloured *= weights[near].repeat(4).reshape(-1, 4)  # Faster than one factor for each four
        self._colours.reshape(-1, 4)[voxels[near]] += coloured

    def _touched(self, seen: _Seen) -> ArrayInt:
        """Places of the blocks around the surfaces of a frame, made where they are new."""
        points_m, rays = seen.surface_points()
        side_m = self.voxel_m * SIDE
        keys: set[int] = set()
        for along_m in (-self._reach_m, 0.0, self._reach_m):
            blocks = np.floor((points_m + along_m * rays) / side_m - OFFSET / SIDE) - self._origin
            is_inside = (np.abs(blocks) < _ZERO // SIDE).all(axis=1)
            keys |= set(np.unique(_keys(blocks[is_inside].astype(np.int64))).tolist())
        new = sorted(keys - self._slots.keys())
        self.is_cut |= len(self._slots) + len(new) > MOST_BLOCKS
        new = new[: MOST_BLOCKS - len(self._slots)]
        self._make(new)
        return np.array(sorted(self._slots[key] for key in keys if key in self._slots), np.int64)

    def _make(self, keys: list[int]) -> None:
        n, needed = len(self._slots), len(self._slots) + len(keys)
        if needed > len(self._blocks):
            more = max(needed, min(2 * len(self._blocks), MOST_BLOCKS)) - len(self._blocks)
            for name in ("_blocks", "_distances", "_weights", "_colours"):
                had = getattr(self, name)
                setattr(self, name, np.concatenate([had, np.zeros((more, *had.shape[1:]), had.dtype)]))
        self._blocks[n:needed] = _unpacked(np.array(keys, np.int64))
        self._slots.update(zip(keys, range(n, needed), strict=True))

    def mesh(self) -> ScanMesh:
        """All surfaces so far; empty where there is none."""
        n, cube = len(self._slots), (len(self._slots), SIDE, SIDE, SIDE)
        distances = self._distances[:n].reshape(cube)
        is_near = (self._weights[:n].reshape(cube) > 0) & (np.abs(distances) < 0.99 * self._reach_m)
        colours = self._colours[:n].reshape(-1, 4)
        crossings = [self._crossings(axis, distances, is_near, colours) for axis in range(3)]
        cells = np.concatenate([crossing.cells for crossing in crossings])
        keys, corners = np.unique(_keys(cells.reshape(-1, 3)), return_inverse=True)
        quads = corners.reshape(-1, 4)
        of_edges = np.concatenate([np.column_stack([one.places, one.colours]) for one in crossings])
        n_around = np.bincount(quads.ravel(), minlength=len(keys))
        sums = [np.bincount(quads.ravel(), values.repeat(4), len(keys)) for values in of_edges.T]
        found = np.stack(sums, axis=1) / n_around[:, None] if len(keys) else np.zeros((0, 6))
        points_m, light = (found[:, :3] + self._origin * SIDE + OFFSET) * self.voxel_m, found[:, 3:]
        return _without_pieces(ScanMesh(points_m.astype(np.float32), quads, light.astype(np.float32), self.is_cut))

    def _crossings(self, axis: int, distances: ArrayF32, is_near: ArrayBool, colours: ArrayF32) -> _Crossings:
        """Where distances change their sign between a voxel and the next one along `axis`."""
        n, step = len(distances), np.eye(3, dtype=np.int64)[axis]
        after = np.array([self._slots.get(key, -1) for key in _keys(self._blocks[:n] + step).tolist()], np.int64)
        first, rest = _along(axis, slice(0, 1)), _along(axis, slice(1, None))
        has_next = (after >= 0).reshape(-1, 1, 1, 1)
        next_near = np.concatenate([is_near[rest], is_near[first][after] & has_next], axis=1 + axis)
        following = np.concatenate([distances[rest], distances[first][after]], axis=1 + axis)
        is_crossed = is_near & next_near & ((distances >= 0) != (following >= 0))
        block, *local = np.nonzero(is_crossed)
        voxels = self._blocks[block] * SIDE + np.stack(local, axis=1)
        here, there = distances[is_crossed].astype(np.float64), following[is_crossed].astype(np.float64)
        share = here / (here - there)
        flat = np.ravel_multi_index((block, *local), is_near.shape)
        local[axis] = (local[axis] + 1) % SIDE
        beyond = np.where(local[axis] == 0, after[block], block)
        other = np.ravel_multi_index((beyond, *local), is_near.shape)
        light = colours[flat].astype(np.float64) + colours[other]
        b, c = np.eye(3, dtype=np.int64)[[(axis + 1) % 3, (axis + 2) % 3]]
        around = np.stack([voxels - b - c, voxels - c, voxels, voxels - b], axis=1)
        faces_back = (here >= 0)[:, None, None]
        return _Crossings(
            np.where(faces_back, around[:, ::-1], around),
            voxels + share[:, None] * step,
            light[:, :3] / np.maximum(light[:, 3:], 1e-12),
        )


@dataclass(frozen=True, eq=False)
class _Crossings:
    """Edges that cross a surface: the four cells around each (K, 4, 3), in the order of a face's corners, where it
    crosses (K, 3), in voxels, and its colour there (K, 3)."""

    cells: ArrayInt
    places: ArrayF64
    colours: ArrayF64


@dataclass(frozen=True, eq=False)
class _Seen:
    """One frame, as its voxels ask about it.

    `inverse` (H, W) is 1 / plane depth, NaN where that is not to be used, `facing` (H, W) the share of a step along the
    ray that leads towards the surface, over plane depth, and `light` (H * W, 4) linear colour and 1.
    """

    intrinsics: Intrinsics
    world_from_camera: ArrayF64
    inverse: ArrayF32
    facing: ArrayF32
    light: ArrayF32

    @classmethod
    def of(cls, frame: RgbdFrame, exposure: float) -> _Seen:
        k = frame.intrinsics
        step = int(np.ceil(np.sqrt(k.width * k.height / MOST_PIXELS)))
        depth_m, srgb = frame.plane_depth_m[::step, ::step], frame.srgb_u8[::step, ::step]
        height, width = depth_m.shape
        k = Intrinsics(width, height, k.fx / step, k.fy / step, *((c - 0.5) / step + 0.5 for c in (k.cx, k.cy)))
        is_used = valid_plane_depth(depth_m) & (depth_m > NEAREST_M) & (depth_m < FARTHEST_M)
        if frame.confidence is not None:
            is_used &= frame.confidence[::step, ::step] > 0
        inverse = np.full(depth_m.shape, np.nan, np.float32)
        inverse[is_used] = 1 / depth_m[is_used]
        inverse, facing = _clear(inverse, k)
        gains = exposure / frame.exposure / (np.ones(3) if frame.white_balance is None else frame.white_balance)
        linear = np.stack([(LINEAR_OF_CODE * gains[channel])[srgb[..., channel]] for channel in range(3)], axis=-1)
        coloured = np.ones((height * width, 4), np.float32)
        coloured[:, :3] = linear.reshape(-1, 3)
        return cls(k, frame.world_from_camera, inverse, facing, coloured)

    def surface_points(self) -> tuple[ArrayF64, ArrayF64]:
        """(K, 3) some of the points that are seen, world, metres, and unit rays (K, 3) to them."""
        step, k = int(np.ceil(np.sqrt(self.inverse.size / MOST_ALLOCATING))), self.intrinsics
        rows, columns = np.nonzero(np.isfinite(self.inverse[::step, ::step]))
        rows, columns = rows * step, columns * step
        rays = (
            np.stack([(columns + 0.5 - k.cx) / k.fx, (k.cy - rows - 0.5) / k.fy, -np.ones(len(rows))], axis=1)
            @ self.world_from_camera[:3, :3].T
        )
        points_m = self.world_from_camera[:3, 3] + rays / self.inverse[rows, columns].astype(np.float64)[:, None]
        return points_m, rays / np.linalg.norm(rays, axis=1, keepdims=True)

    def distances(
        self, points: ArrayF32, reach_m: float, ends_m: ArrayF32
    ) -> tuple[ArrayInt, ArrayF32, ArrayF32, ArrayInt]:
        """Of points (3, N) in the camera's frame: which (K,) are known of, their distances in front of the surface,
        at most `reach_m` and no further behind it, the weights of these, and the pixels that show it."""
        k, inverse = self.intrinsics, self.inverse.reshape(-1)
        depth_m = -points[2]
        with np.errstate(divide="ignore", invalid="ignore"):  # In the camera's own plane, which is not seen.
            x = points[0] * np.float32(k.fx) / depth_m + np.float32(k.cx - 0.5)
            y = np.float32(k.cy - 0.5) - points[1] * np.float32(k.fy) / depth_m
            is_seen = (depth_m > NEAREST_M) & (x >= 0) & (y >= 0) & (x < k.width - 1) & (y < k.height - 1)
        found = np.flatnonzero(is_seen)
        x, y, depth_m = x[found], y[found], depth_m[found]
        left, top = x.astype(np.int32), y.astype(np.int32)
        corner = (top * np.int32(k.width) + left).astype(np.intp)
        near = np.flatnonzero(depth_m < ends_m.take(corner))  # Half of all: the rest is not looked at any further.
        found, depth_m, corner = found[near], depth_m[near], corner[near]
        right, down = x[near] - left[near], y[near] - top[near]
        above = inverse[corner] * (1 - right) + inverse[corner + 1] * right
        below = inverse[corner + k.width] * (1 - right) + inverse[corner + k.width + 1] * right
        between = above * (1 - down) + below * down
        pixel = corner + (right > 0.5) + (down > 0.5) * k.width
        facing = self.facing.reshape(-1)[pixel]
        distances_m = (1 / between - depth_m) * facing
        is_known = distances_m > -reach_m  # NaN is not
        kept = np.flatnonzero(is_known)
        weights = facing[kept] * between[kept] ** 2
        return found[kept], np.minimum(distances_m[kept], reach_m), weights, pixel[kept]

    def ends_m(self, reach_m: float) -> ArrayF32:
        """(H, W) a plane depth beyond which nothing between this pixel and the next ones, right and down, is known of;
        the last row and column are not used."""
        with np.errstate(invalid="ignore", divide="ignore"):  # NaN, where there is no depth
            behind = np.stack([1 / self.inverse, reach_m / self.facing])
        pairs = np.maximum(behind[:, :-1], behind[:, 1:])
        ends = np.maximum(pairs[..., :-1], pairs[..., 1:]).sum(axis=0) * 1.0001  # For rounding
        return np.pad(np.nan_to_num(ends, nan=0.0, posinf=np.inf), ((0, 1), (0, 1)))


def _clear(inverse: ArrayF32, k: Intrinsics) -> tuple[ArrayF32, ArrayF32]:
    """`inverse` depth (H, W) without rims and grazing surfaces, and the cosine between normal and ray over the cosine
    between axis and ray (H, W): what a metre of plane depth is across the surface."""
    wide = np.pad(inverse, 1, constant_values=np.nan)
    middle = slice(1, -1)
    sides = (wide[middle, :-2], wide[middle, 2:]), (wide[:-2, middle], wide[2:, middle])
    is_clear, slopes = np.isfinite(inverse), []
    for (before, after), focal in zip(sides, (k.fx, k.fy), strict=True):
        bend = np.abs(before - 2 * inverse + after)
        is_clear &= ~(bend > (RIM + CREASE / focal) * inverse)  # Where a neighbour is unknown it does not count
        slope = np.where(np.isnan(before), after - inverse, np.where(np.isnan(after), inverse - before, after - before))
        n_steps = np.where(np.isnan(before) | np.isnan(after), 1, 2)
        slopes.append(slope / n_steps * np.float32(focal))
    right = ((np.arange(k.width) + 0.5 - k.cx) / k.fx)[None].astype(np.float32)
    down = ((np.arange(k.height) + 0.5 - k.cy) / k.fy)[:, None].astype(np.float32)
    toward = inverse - right * slopes[0] - down * slopes[1]
    with np.errstate(invalid="ignore"):  # NaN, where there is no depth
        facing = inverse / np.sqrt(slopes[0] ** 2 + slopes[1] ** 2 + toward**2)
        is_clear &= facing > GRAZING * np.sqrt(1 + right**2 + down**2)
    return np.where(is_clear, inverse, np.nan).astype(np.float32), facing.astype(np.float32)


def _along(axis: int, part: slice) -> tuple[slice, ...]:
    """Index of blocks (N, 8, 8, 8) that takes a part of one of their axes."""
    index = [slice(None)] * 4
    index[1 + axis] = part
    return tuple(index)


def _keys(blocks: ArrayInt) -> NDArray[np.int64]:
    """(N,) of whole coordinates (N, 3), each below 2**20 in size."""
    x, y, z = (blocks + _ZERO).T
    return np.asarray((x << 2 * _BITS) | (y << _BITS) | z)


def _unpacked(keys: NDArray[np.int64]) -> ArrayInt:
    mask = (1 << _BITS) - 1
    return np.asarray(np.stack([keys >> 2 * _BITS, (keys >> _BITS) & mask, keys & mask], axis=-1) - _ZERO)


def _without_pieces(mesh: ScanMesh) -> ScanMesh:
    """`mesh` without pieces of fewer faces than SMALLEST_PIECE."""
    labels = joined(len(mesh.points_m), mesh.quads.T)
    n_faces = np.bincount(labels[mesh.quads[:, 0]], minlength=len(labels))
    quads = mesh.quads[n_faces[labels[mesh.quads[:, 0]]] >= SMALLEST_PIECE]
    is_kept = np.zeros(len(mesh.points_m), bool)
    is_kept[quads] = True
    renumbered = np.cumsum(is_kept) - 1
    return ScanMesh(mesh.points_m[is_kept], renumbered[quads], mesh.colours[is_kept], mesh.is_cut)
