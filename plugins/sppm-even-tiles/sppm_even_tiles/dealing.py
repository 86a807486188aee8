"""Dealing interiors to cells like cards: equally often, and never the same one side by side."""

from __future__ import annotations

import itertools
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

# what it costs that two cells carry the same interior, by how they touch
FACE, EDGE, CORNER = 100, 10, 1
_COST = {1: FACE, 2: EDGE, 3: CORNER}
_MAX_TRIES = 2000
"""Cells that are tried for a swap with one cell; bounds the time for large parts."""
_MAX_COST_RATIO = 0.98
"""Swapping ends when a pass over all cells has left more than this share of the cost."""


class Alike(NamedTuple):
    """Pairs of touching cells with the same interior, by how the cells touch."""

    face: int
    edge: int
    corner: int


def alike_pairs(interior: NDArray[np.int32]) -> Alike:
    """Count them in interiors (nx, ny, nz); cells without content, -1, do not count."""
    counts = {1: 0, 2: 0, 3: 0}
    for step in itertools.product((-1, 0, 1), repeat=3):
        if step <= (0, 0, 0):
            continue  # the other direction counts the same pairs
        here, there = (
            tuple(slice(max(0, sign * s), min(0, sign * s) or None) for s in step) for sign in (-1, 1)
        )  # the cells that have a neighbor at this step, and those neighbors
        same = (interior[here] == interior[there]) & (interior[here] >= 0)
        counts[sum(map(abs, step))] += int(same.sum())
    return Alike(counts[1], counts[2], counts[3])


def deal(rng: np.random.Generator, mask: NDArray[np.bool_], interiors: int) -> NDArray[np.int32]:
    """Deal shuffled decks of all interiors to the cells of `mask` in raster order, then swap where equal cells touch.

    Each deck is dealt to its end before the next one is shuffled, so that no interior is used more than once more
    often than another. Of the cards left in the deck a cell takes the first that none of its neighbors has, or the
    one that costs least. Swaps keep the numbers and are made only if they lower the cost, so the search ends.
    Returns (nx, ny, nz) int32: 0..interiors-1, and -1 outside of the mask.
    """
    # one empty layer all around, so that neighbors are fixed steps in the flat list
    padded = np.pad(np.asarray(mask, np.bool_), 1)
    offsets = [step for step in itertools.product((-1, 0, 1), repeat=3) if any(step)]
    steps = np.array(offsets) @ np.array(padded.strides)
    prices = np.array([_COST[sum(map(abs, step))] for step in offsets])
    places = np.flatnonzero(padded)
    cells = _dealt(rng, places, padded.size, interiors, steps, prices)
    before = np.inf
    while True:
        own = _cost(cells, places, cells[places], steps, prices)
        if own.sum() == 0 or own.sum() > _MAX_COST_RATIO * before:
            break
        before = own.sum()
        for place in places[own > 0]:
            _swap(rng, cells, places, place, steps, prices)
    return np.ascontiguousarray(cells.reshape(padded.shape)[1:-1, 1:-1, 1:-1])


def _dealt(
    rng: np.random.Generator,
    places: NDArray[np.int64],
    size: int,
    interiors: int,
    steps: NDArray[np.int64],
    prices: NDArray[np.int64],
) -> NDArray[np.int32]:
    """Deal the decks, looking at the cells that were filled before; (size,) int32, -1 elsewhere."""
    cells = [-1] * size  # plain lists: one number at a time, they are faster than arrays
    around = list(zip(steps.tolist(), prices.tolist(), strict=True))
    deck: list[int] = []
    for place in places.tolist():
        if not deck:
            deck = rng.permutation(interiors).tolist()
        near: dict[int, int] = {}
        for step, price in around:
            card = cells[place + step]
            near[card] = near.get(card, 0) + price
        pick = (
            min(range(len(deck)), key=lambda n: near.get(deck[n], 0))
            if near.keys() >= set(deck)
            else next(n for n, card in enumerate(deck) if card not in near)
        )
        cells[place] = deck.pop(pick)
    return np.array(cells, np.int32)


def _cost(
    cells: NDArray[np.int32],
    places: NDArray[np.int64],
    cards: NDArray[np.int32] | np.int32,
    steps: NDArray[np.int64],
    prices: NDArray[np.int64],
) -> NDArray[np.int64]:
    """Cost of `cards` at `places`, among the neighbors that are there; (n,) int64."""
    total = np.zeros(len(places), np.int64)
    for step, price in zip(steps, prices, strict=True):
        total += price * (cells[places + step] == cards)
    return total


def _swap(
    rng: np.random.Generator,
    cells: NDArray[np.int32],
    places: NDArray[np.int64],
    place: np.int64,
    steps: NDArray[np.int64],
    prices: NDArray[np.int64],
) -> None:
    """Swap the card at `place` with the one that lowers the cost most, if there is one."""
    mine = cells[place]
    others = places if len(places) <= _MAX_TRIES else rng.choice(places, _MAX_TRIES, replace=False)
    # a swap with a neighbor would change the very cells that its cost is counted from
    others = others[(cells[others] != mine) & ~np.isin(others, place + steps)]
    theirs = cells[others]
    if not len(others):
        return
    near = cells[place + steps]
    at_place = np.bincount(near[near >= 0], prices[near >= 0], int(cells.max()) + 1).astype(np.int64)
    gain = at_place[theirs] - at_place[mine]
    gain += _cost(cells, others, mine, steps, prices) - _cost(cells, others, theirs, steps, prices)
    best = int(np.argmin(gain))
    if gain[best] < 0:
        cells[place], cells[others[best]] = theirs[best], mine
