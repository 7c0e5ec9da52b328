"""Compiled loops that paint a plate with a picture: trilinear by each pixel's footprint, exact rims.

Runs of pixels that lie wholly on the picture and between the same two of its levels are painted in short
loops over buffers, which compilers vectorise; pixels of the rim one by one. Both come to the same bit.
"""

import math
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from foundation.compiled import allocation_free
from plant_emulator.core.camera.fetching import Pairs, Words, load_both
from plant_emulator.core.camera.rasteriser import most_reach, share_below
from plant_emulator.core.camera.rays import (
    PlatePoint,
    Rays,
    Surface,
    fetch_rays,
    meet_plate,
    places_on_plate,
    row_homography,
    shaded,
)

Grey = NDArray[np.uint8]
Real64 = NDArray[np.float64]
Word = Any  # np.int32: type checkers see it as a plain int at the call

_STRIDE = 16  # pixels
_LONGEST = 256  # pixels of a run: its buffers stay in the nearest cache
_FINEST_ALONE, _RIM, _BESIDE = -1, -2, -3  # as ``_Room.kind`` says them
_NEAR = 1e-9  # smallest inverse depth, 1/m, that still counts as in front


class Panel(NamedTuple):
    """A picture between two edges across and two down, in metres.

    ``levels``: its texels as ``pairs_of`` keeps them, the finest first, each half as fine as the one before.
    """

    edges_x: Real64
    edges_y: Real64
    levels: tuple[Pairs, ...]


class _Samples(NamedTuple):
    """Where pixels are between texels, and the grey there: room for a run."""

    words: Words
    part_x: Real64
    part_y: Real64
    grey: Real64


class _Room(NamedTuple):
    """Room for a row: its homography, and of its pixels the places, the levels and the kinds; and for a run.

    ``kind``: the finer of the two levels that a pixel lies between, ``_FINEST_ALONE`` where none is finer
    than it, ``_RIM`` where it may not be whole on the picture, ``_BESIDE`` where it is not on it.
    """

    h: Real64
    places: Real64
    level: Real64
    kind: Words
    fine: _Samples
    coarse: _Samples


def paint_panel(
    out: Grey,
    rays: Rays,
    homographies: Real64,
    panel: Panel,
    box: tuple[int, int, int, int],
    surface: Surface,
) -> None:
    """Paint one picture plate over ``out`` inside ``box``; arguments as of ``rasteriser.paint_plate``."""
    width = box[3] - box[2]
    fine, coarse = (_Samples(np.empty(_LONGEST, np.int32), *np.empty((3, _LONGEST))) for _ in range(2))
    kind = np.empty(width, np.int32)
    room = _Room(np.empty((3, 3)), np.empty((3, width)), np.empty(width), kind, fine, coarse)
    _paint_rows(out, rays, homographies, panel, box, surface, room)


@allocation_free(nogil=True)
def _paint_rows(
    out: Grey,
    rays: Rays,
    homographies: Real64,
    panel: Panel,
    box: tuple[int, int, int, int],
    surface: Surface,
    room: _Room,
) -> None:
    top, bottom, first, last = box
    for i in range(top, bottom):
        fetch_rays(rays, i + 1, first, last)
        row_homography(homographies, i, out.shape[0], room.h)
        places_on_plate(rays.x[i, first:last], rays.y[i, first:last], room.h, room.places)
        _note_levels(rays, i, first, panel, room)
        _note_kinds(most_reach(rays, room.h, i, (first, last)), panel, room)
        k = end = 0
        while k < last - first:
            kind, end = room.kind[k], _end_of_run(room.kind, k)
            if kind == _RIM:
                for j in range(k, end):
                    _paint_rim(out, rays, (i, first + j), panel, surface, room, j)
            elif kind != _BESIDE:
                _paint_run(out[i, first + k : first + end], panel, surface, room, k)
            k = end


@allocation_free
def _note_levels(rays: Rays, i: int, first: int, panel: Panel, room: _Room) -> None:
    """Fill in how often the picture is to be halved for the pixels of row ``i`` from ``first`` on."""
    level, last = room.level, room.level.shape[0] - 1
    at_k = _level(rays, room.h, i, first, panel)
    for k in range(0, last + 1, _STRIDE):  # a footprint changes by a part in a thousand over so few pixels
        far = min(k + _STRIDE, last)
        at_far = _level(rays, room.h, i, first + far, panel)
        rise = (at_far - at_k) / max(far - k, 1)
        for j in range(min(_STRIDE, last + 1 - k)):
            level[k + j] = at_k + rise * j
        at_k = at_far


@allocation_free(inline="always")
def _level(rays: Rays, h: Real64, i: int, j: int, panel: Panel) -> float:
    """How often the picture is to be halved for the footprint of pixel (i, j); negative: it is finer."""
    at, texels_per_m = meet_plate(rays, h, i, j), _texels_per_m(panel)
    area = abs(at.s_u * at.t_v - at.s_v * at.t_u)
    return 0.5 * math.log2(max(area * texels_per_m * texels_per_m, 1e-12))


@allocation_free(inline="always")
def _texels_per_m(panel: Panel) -> float:
    return float(panel.levels[0].shape[1] / (panel.edges_x[1] - panel.edges_x[0]))


@allocation_free(inline="always")
def _coarsest(panel: Panel) -> float:
    """The level up to which there is a coarser one to blend with; negative where there never is."""
    return len(panel.levels) - 1.000001


@allocation_free
def _note_kinds(reach: tuple[float, float], panel: Panel, room: _Room) -> None:
    """Fill in which pixels are on the picture, and between which of its levels."""
    reach_s, reach_t = reach
    left, right, top, bottom = panel.edges_x[0], panel.edges_x[1], panel.edges_y[0], panel.edges_y[1]
    s, t, w, level = room.places[0], room.places[1], room.places[2], room.level
    kind, coarsest = room.kind, _coarsest(panel)
    for k in range(level.shape[0]):
        across = (s[k] + reach_s > left) & (s[k] - reach_s < right)
        down = (t[k] + reach_t > top) & (t[k] - reach_t < bottom)
        whole_across = (left <= s[k] - reach_s) & (s[k] + reach_s <= right)
        whole_down = (top <= t[k] - reach_t) & (t[k] + reach_t <= bottom)
        on_it = np.int32(_RIM) if across & down & (w[k] > _NEAR) else np.int32(_BESIDE)
        between = _between(level[k], coarsest)
        kind[k] = between if whole_across & whole_down & (w[k] > _NEAR) else on_it


@allocation_free(inline="always")
def _between(level: float, coarsest: float) -> Word:
    """The finer of the two levels that ``level`` lies between."""
    return np.int32(min(level, coarsest)) if (level > 0.0) & (coarsest > 0.0) else np.int32(_FINEST_ALONE)


@allocation_free
def _end_of_run(kind: Words, k: int) -> int:
    """The first pixel after ``k`` that cannot be painted with it."""
    end, farthest = k + 1, min(k + _LONGEST, kind.shape[0])
    while end < farthest and kind[end] == kind[k]:
        end += 1
    return end


@allocation_free
def _paint_run(target: Grey, panel: Panel, surface: Surface, room: _Room, k: int) -> None:
    """Paint ``target``, the pixels of a run from ``k`` on."""
    end, light, shadow, grey = k + target.shape[0], surface.light, surface.shadow, room.fine.grey
    s, t = room.places[0, k:end], room.places[1, k:end]
    _find_greys(panel, room, k, end, room.kind[k])
    even, per_s, per_t = light[0], light[1], light[2]
    for j in range(target.shape[0]):
        value = grey[j] * ((even + per_s * s[j] + per_t * t[j]) * shaded(s[j], t[j], shadow))
        target[j] = np.uint8(np.int32(min(max(value, 0.0), 255.0) + 0.5))


@allocation_free
def _paint_rim(
    out: Grey, rays: Rays, pixel: tuple[int, int], panel: Panel, surface: Surface, room: _Room, k: int
) -> None:
    """Blend ``pixel``, the ``k``-th of the row, with what is beside the picture."""
    i, j = pixel
    alpha = _share(meet_plate(rays, room.h, i, j), panel.edges_x, panel.edges_y)
    if alpha > 0.0:
        s, t, light = room.places[0, k], room.places[1, k], surface.light
        _find_greys(panel, room, k, k + 1, _between(room.level[k], _coarsest(panel)))
        lit = (light[0] + light[1] * s + light[2] * t) * shaded(s, t, surface.shadow)
        value = alpha * room.fine.grey[0] * lit + (1.0 - alpha) * out[i, j]
        out[i, j] = np.uint8(min(max(value, 0.0), 255.0) + 0.5)


@allocation_free(inline="always")
def _share(at: PlatePoint, edges_x: Real64, edges_y: Real64) -> float:
    """The pixel's share in the panel."""
    return _strip(at.s, abs(at.s_u), abs(at.s_v), edges_x) * _strip(at.t, abs(at.t_u), abs(at.t_v), edges_y)


@allocation_free(inline="always")
def _strip(centre: float, a: float, b: float, edges: Real64) -> float:
    """The pixel's share between the two edges; ``a`` and ``b`` are its extents across them."""
    long, short = max(a, b), min(a, b)
    return share_below(edges[1] - centre, long, short) - share_below(edges[0] - centre, long, short)


@allocation_free
def _find_greys(panel: Panel, room: _Room, k: int, end: int, between: Word) -> None:
    """Fill ``room.fine.grey`` with pixels ``k`` to ``end``, all ``between`` the same two levels."""
    s, t = room.places[0, k:end], room.places[1, k:end]
    _sample(panel, max(between, 0), s, t, room.fine)
    if between == _FINEST_ALONE:
        return
    _sample(panel, between + 1, s, t, room.coarse)
    fine, coarse, level = room.fine.grey, room.coarse.grey, room.level[k:end]
    finer, coarsest = np.float64(between), _coarsest(panel)
    for j in range(end - k):
        fine[j] += (coarse[j] - fine[j]) * (min(level[j], coarsest) - finer)


@allocation_free
def _sample(panel: Panel, level: int, s: Real64, t: Real64, room: _Samples) -> None:
    """Fill in the greys of one level at the places ``s``, ``t`` (n,), bilinear."""
    texels, scale, texels_per_m = panel.levels[level], 1.0 / (1 << level), _texels_per_m(panel)
    left, top, (height, width) = panel.edges_x[0], panel.edges_y[0], texels.shape
    words, part_x, part_y, grey = room
    for j in range(s.shape[0]):
        column = min(max((s[j] - left) * texels_per_m * scale - 0.5, 0.0), width - 1.0)
        row = min(max((t[j] - top) * texels_per_m * scale - 0.5, 0.0), height - 1.0)
        m, n = min(np.int32(row), np.int32(height - 2)), min(np.int32(column), np.int32(width - 2))
        part_x[j], part_y[j] = column - n, row - m
        words[j] = np.int32(np.int32(m * np.int32(width)) + n)
    for j in range(s.shape[0]):
        words[j] = load_both(texels, np.intp(words[j]))
    for j in range(s.shape[0]):
        word, a, b = words[j], part_x[j], part_y[j]
        upper = _byte(word, 0) * (1.0 - a) + _byte(word, 16) * a
        lower = _byte(word, 8) * (1.0 - a) + _byte(word, 24) * a
        grey[j] = upper * (1.0 - b) + lower * b


@allocation_free(inline="always")
def _byte(word: Word, shift: int) -> float:
    """The 8 bits of ``word`` from ``shift`` on."""
    return np.float64(np.int32(np.int32(word >> np.int32(shift)) & np.int32(255)))
