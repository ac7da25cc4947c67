"""What is expected is a guess in a file: written in place, read when whole, and never missed."""

import msgspec

from phyagentos.protocol.sessions.outlook import Outlook
from tests.contracts import make_contract


def test_the_latest_guess_is_found_whatever_stood_there_before(tmp_path):
    outlook = Outlook(tmp_path / "cache")

    for objective in ("a", "a much longer one", "b"):
        outlook.expect(make_contract(target="arm", objective=objective))

        assert outlook.find("arm") == make_contract(target="arm", objective=objective)


def test_nobody_expects_anything_of_another_target(tmp_path):
    Outlook(tmp_path).expect(make_contract(target="arm", objective="a"))

    assert Outlook(tmp_path).find("leg") is None


def test_a_torn_guess_is_none(tmp_path):
    outlook = Outlook(tmp_path)
    outlook.expect(make_contract(target="arm", objective="a"))
    whole = msgspec.json.encode(make_contract(target="arm", objective="a"))

    for length in range(len(whole)):
        (tmp_path / "outlook" / "arm.json").write_bytes(whole[:length])
        assert outlook.find("arm") is None


def test_where_nothing_can_be_written_nothing_is_expected(tmp_path):
    (tmp_path / "cache").write_text("a file where the folder should be")
    outlook = Outlook(tmp_path / "cache")

    outlook.expect(make_contract(target="arm", objective="a"))

    assert outlook.find("arm") is None
