"""The two shapes of no work that every system is given; needs nothing but Python, since peers run it too.

`layered`: ten layers of equal width, each node after two of the layer above. `chain`: each node after the one before.
"""

LAYERS = 10


def build_edges(shape: str, n: int) -> list[list[int]]:
    """The nodes that come before each node, which is its index."""
    if shape == "chain":
        return [[index - 1] if index else [] for index in range(n)]
    width = max(1, n // LAYERS)
    before = []
    for index in range(n):
        layer, place = divmod(index, width)
        above = (layer - 1) * width
        before.append(sorted({above + place, above + (place + 1) % width}) if layer else [])
    return before
