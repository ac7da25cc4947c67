"""Graphs in layers: what comes first stands above, and every text is data."""

import re
from xml.etree import ElementTree

from hypothesis import given
from hypothesis import strategies as st

from phyagentos.pictures.layers import draw_layers
from phyagentos.pictures.statechart import draw_statechart
from phyagentos.protocol.documents.flowchart import Arrow, Box
from phyagentos.protocol.sessions.lifecycle import SessionState

SVG = "{http://www.w3.org/2000/svg}"


def find_tops(svg):
    """Name of each box -> its distance from the top."""
    found = {}
    for group in ElementTree.fromstring(svg).iter(f"{SVG}g"):
        found[group.find(f"{SVG}text").text] = float(group.find(f"{SVG}rect").get("y"))
    return found


@given(st.sets(st.tuples(st.integers(0, 12), st.integers(0, 12)), max_size=40))
def test_what_comes_first_stands_above(pairs):
    ahead = [(before, after) for before, after in pairs if before < after]
    boxes = [Box(name=str(n), title=f"n{n}") for n in range(13)]
    tops = find_tops(draw_layers(boxes, [Arrow(str(before), str(after)) for before, after in ahead], "A graph"))
    assert len(tops) == 13
    assert all(tops[f"n{before}"] < tops[f"n{after}"] for before, after in ahead)


@given(st.text(st.characters(codec="utf-8", exclude_categories=("Cc", "Cs"), exclude_characters="￾￿")))
def test_every_text_is_data(text):
    svg = draw_layers([Box(name="a", title=text, below=[text], link=f"#{text}", hint=text)], [], text)
    (title, *_) = [each.text for each in ElementTree.fromstring(svg).iter(f"{SVG}title")]
    assert (title or "") == text


def test_a_statechart_shows_every_state_where_a_session_stands_and_has_been():
    svg = draw_statechart(["pending", "claimed", "preflight", "running"])
    kinds = {}
    for group in ElementTree.fromstring(svg).iter(f"{SVG}g"):
        kinds[group.find(f"{SVG}text").text.replace(" ", "_")] = group.get("class").split()[1:]
    assert kinds.keys() == {state.value for state in SessionState}
    assert kinds["running"] == ["here"]
    assert [state for state, kind in kinds.items() if kind == ["been"]] == ["pending", "claimed", "preflight"]
    assert len(re.findall(r'class="edge', draw_statechart())) > 20
