"""Friction by pairs of surfaces: the one table, and what of it a seed draws.

All values are static and dry, and stay within 0.2 to 0.6. Sources: CTU, "Code of Practice for Packing of Cargo
Transport Units" (IMO/ILO/UNECE 2014), annex 7 appendix 2; VDI, VDI 2700 sheet 15, anti-slip mats with every partner;
TB, handbook tables of clean dry pairs (glass on metal 0.5 to 0.7, greasy 0.2 to 0.3; polystyrene on steel 0.3 to
0.35); own, this project's assumption between its neighbours.
"""

from enum import StrEnum
from itertools import combinations_with_replacement

from phyagentos.protocol.world.seeds import compute_seed

Span = tuple[float, float]


class Surface(StrEnum):
    """What a surface is made of."""

    WOOD = "wood"
    PLASTIC = "plastic"
    METAL = "metal"
    GLASS = "glass"
    CERAMIC = "ceramic"
    CARD = "card"
    FELT = "felt"
    RUBBER = "rubber"


_TABLE = """
wood    wood    0.30 0.45 CTU planed, sawn
wood    plastic 0.20 0.30 CTU plastic pallet, shrink film
wood    metal   0.20 0.45 CTU planed on stainless sheet, steel crate on plywood
wood    glass   0.20 0.40 own
wood    ceramic 0.20 0.40 own
wood    card    0.40 0.50 CTU 0.5
wood    felt    0.30 0.50 own
plastic plastic 0.25 0.35 CTU shrink film 0.3
plastic metal   0.20 0.35 TB; CTU 0.15 on stainless sheet
plastic glass   0.20 0.40 own
plastic ceramic 0.20 0.40 own
plastic card    0.25 0.35 own
plastic felt    0.20 0.40 own
metal   metal   0.20 0.40 CTU smooth, rough
metal   glass   0.30 0.50 TB between clean and greasy
metal   ceramic 0.30 0.50 own
metal   card    0.30 0.40 own
metal   felt    0.20 0.40 own
glass   glass   0.30 0.50 own
glass   ceramic 0.30 0.50 own
glass   card    0.30 0.40 own
glass   felt    0.20 0.40 own
ceramic ceramic 0.30 0.50 own
ceramic card    0.30 0.40 own
ceramic felt    0.30 0.50 own
card    card    0.40 0.50 CTU 0.5
card    felt    0.30 0.50 own
felt    felt    0.40 0.60 own
rubber  *       0.45 0.60 VDI 0.6 when clean; own when dusty
"""

_ROLLING_M = {  # lever arm of rolling resistance; wood on wood 0.5 to 1.5 mm, steel on steel 0.1 mm in handbooks
    **dict.fromkeys((Surface.METAL, Surface.GLASS, Surface.CERAMIC), 1e-4),
    Surface.PLASTIC: 3e-4,
    Surface.WOOD: 5e-4,
    Surface.CARD: 1e-3,
    Surface.RUBBER: 1e-3,
    Surface.FELT: 2e-3,
}


def name_pair(one: Surface, other: Surface) -> str:
    """Name of a pair in either order, as a scene file gives it (`plastic|wood`)."""
    return "|".join(sorted((one, other)))


def _read_table() -> dict[str, Span]:
    table: dict[str, Span] = {}
    for line in _TABLE.split("\n")[1:-1]:
        one, other, low, high, *_ = line.split()
        for each in Surface if other == "*" else (Surface(other),):
            table[name_pair(Surface(one), each)] = (float(low), float(high))
    return table


FRICTION: dict[str, Span] = _read_table()
PAIRS = tuple(name_pair(one, other) for one, other in combinations_with_replacement(Surface, 2))


def compute_rolling_m(one: Surface, other: Surface) -> float:
    """Lever arm of rolling resistance [m]: that of the softer surface."""
    return max(_ROLLING_M[one], _ROLLING_M[other])


def draw_friction(given: dict[str, Span], seed: int) -> dict[str, float]:
    """The true coefficient of every pair in one scene; spans in `given` replace those of the table."""
    drawn = {}
    for pair in PAIRS:
        low, high = given.get(pair, FRICTION[pair])
        drawn[pair] = low + (high - low) * compute_seed(seed, "friction", pair) / 2**63
    return drawn
