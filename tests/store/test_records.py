"""The frame phy1: what was written is found again, what was changed is not believed."""

import msgspec
import pytest
from hypothesis import given
from hypothesis import strategies as st

from phyagentos.errors import DefinitionError
from phyagentos.protocol.documents.body_codec import render_body
from phyagentos.store.records import Record, Tail, encode_record, scan_records

NAMES = st.text(st.characters(exclude_categories=["Cs"]), min_size=1, max_size=20)


def make_record(seq, more=0, **facts):
    return Record(
        **(
            {"seq": seq, "id": f"s{seq}", "ev": "submit", "to": "pending", "by": "agent", "side": "agent", "epoch": 0}
            | {"at": "2026-11-21T14:31:07.123456Z", "more": more, "markdown": render_body({"objective": f"ü {seq}"})}
            | facts
        )
    )


def encode(records):
    return b"".join(encode_record(record) for record in records)


THREE = [make_record(1), make_record(2, ev="claim", markdown=""), make_record(3)]


def test_a_record_looks_as_the_format_says():
    text = encode_record(make_record(4711, id="s-1", markdown=render_body({"id": "s-1"}))).decode()

    assert text == (
        "<!-- phy1 0000004711 000136 " + text[28:36] + " -->\n"
        '- {"id":"s-1","ev":"submit","to":"pending","by":"agent","side":"agent","ep":0,'
        '"at":"2026-11-21T14:31:07.123456Z"}\n'
        "\n```yaml\nid: s-1\n```\n\n"
    )


@pytest.mark.slow
@given(st.lists(st.tuples(NAMES, NAMES, st.integers(0, 99), st.dictionaries(NAMES, NAMES, max_size=3)), max_size=6))
def test_records_come_back_as_they_were(facts):
    records = [
        make_record(seq, id=id, by=by, epoch=epoch, markdown=render_body(body))
        for seq, (id, by, epoch, body) in enumerate(facts, 1)
    ]

    data = encode(records)
    scan = scan_records(data, 0)

    assert list(scan.records) == records
    assert [record.body for record in scan.records] == [body or None for *_, body in facts]
    assert (scan.end, scan.tail) == (len(data), Tail.CLEAN)


def test_every_single_flipped_bit_is_noticed():
    data = encode(THREE)
    starts = [data.index(b"<!-- phy1 %010d" % seq) for seq in (1, 2, 3)]
    for position in range(len(data)):
        for bit in (0, 3, 7):
            changed = bytearray(data)
            changed[position] ^= 1 << bit
            scan = scan_records(bytes(changed), 0)
            hit = max(index for index, start in enumerate(starts) if start <= position)

            assert list(scan.records) == THREE[:hit], (position, bit)
            assert (scan.end, scan.tail) == (starts[hit], Tail.DAMAGED), (position, bit)


@given(st.integers(0, len(encode(THREE))))
def test_a_prefix_is_torn_and_never_damaged(length):
    scan = scan_records(encode(THREE)[:length], 0)

    assert list(scan.records) == THREE[: len(scan.records)]
    assert scan.tail is (Tail.CLEAN if scan.end == length else Tail.TORN)


@given(st.data())
def test_a_batch_counts_only_as_a_whole(data):
    batch = [make_record(1), make_record(2, more=2), make_record(3, more=1), make_record(4)]
    first, whole = len(encode(batch[:1])), len(encode(batch))
    length = data.draw(st.integers(first, whole - 1))

    scan = scan_records(encode(batch)[:length], 0)

    assert list(scan.records) == batch[:1]
    assert (scan.end, scan.tail) == (first, Tail.CLEAN if length == first else Tail.TORN)


def test_a_record_in_another_place_is_not_believed():
    assert scan_records(encode_record(make_record(2)), 0).tail is Tail.DAMAGED
    assert scan_records(encode_record(make_record(1)) * 2, 0).tail is Tail.DAMAGED


def test_a_record_behind_a_gap_of_stray_text_is_damage():
    data = encode(THREE[:1]) + b"a note by hand, longer than any header could be\n" + encode(THREE[1:])

    assert scan_records(data, 0).tail is Tail.DAMAGED
    assert scan_records(encode(THREE[:1]) + encode(THREE[1:2])[:60] + encode(THREE[1:]), 0).tail is Tail.DAMAGED


def test_a_record_that_is_too_large_names_the_way_out():
    with pytest.raises(DefinitionError, match=r"s1: submit: TOO_LARGE.*at most 999999.*evidence folder"):
        encode_record(make_record(1, markdown="x" * 1_000_000))


def test_a_record_is_frozen():
    with pytest.raises(AttributeError, match="immutable"):
        make_record(1).seq = 2

    assert msgspec.structs.replace(make_record(1), seq=2).seq == 2
