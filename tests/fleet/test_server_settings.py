"""What a server of a fleet permits: each writes its own, with a password of its own."""

import stat

import pytest

from phyagentos.errors import DefinitionError
from phyagentos.fleet.bus import HUB, OPERATOR, hide_token
from phyagentos.fleet.server_settings import FleetSettings, configure
from phyagentos.fleet.subjects import list_rights
from phyagentos.protocol.documents.schema import read_yaml, validate

SETTINGS = """
servers:
  a: {listen: "127.0.0.1:4222", cluster: "127.0.0.1:6222"}
  b: {listen: "127.0.0.1:4223", cluster: "127.0.0.1:6223"}
hosts: [h1, bench.2]
tls: {certificate: this.pem, key: this.key, ca: ca.pem}
"""


def prepare(folder, text, member):
    settings = folder / "fleet.yaml"
    settings.write_text(text)
    return configure(validate(FleetSettings, read_yaml(settings)), settings, member, folder / member)


def test_a_host_may_write_and_hear_under_its_own_name_alone():
    one, other = list_rights("h1"), list_rights("h2")
    written = set(one["publish"]["allow"]) & set(other["publish"]["allow"])
    assert all(each.startswith("$JS.API.") and each.split(".")[2] != "CONSUMER" for each in written)
    assert not any(each in {">", "*"} or "CREATE" in each or "DELETE" in each for each in one["publish"]["allow"])
    heard = set(one["subscribe"]["allow"]) & set(other["subscribe"]["allow"])
    assert heard == {"paos.news.$KV.paos_offers.>", "paos.news.$KV.paos_stops.>"}
    assert "$KV.paos_stops.stop" in list_rights(OPERATOR)["publish"]["allow"]
    assert not any("paos_claims" in each and "$KV" in each for each in list_rights(OPERATOR)["publish"]["allow"])


def test_servers_of_one_file_know_each_other_and_their_users_keep_their_passwords(tmp_path):
    first, second, again = (prepare(tmp_path, SETTINGS, member) for member in "aba")
    assert first.urls == second.urls == again.urls
    assert first.urls.keys() == {HUB, OPERATOR, "h1", "bench.2"}
    assert hide_token(first.urls["h1"]) == "127.0.0.1:4222,127.0.0.1:4223"
    assert first.urls["h1"].startswith("tls://h1:")
    assert second.config["cluster"]["routes"][0].endswith("@127.0.0.1:6222")
    assert second.config["tls"]["cert_file"] == str(tmp_path / "this.pem")
    assert stat.S_IMODE((tmp_path / "fleet.secrets").stat().st_mode) == 0o600


@pytest.mark.parametrize(
    ("text", "member", "found"),
    [(SETTINGS, "c", r"--member.*'c'.*a, b"), ("server: {}", "a", "servers"), ("servers: {a: {}}", "a", "listen")],
)
def test_settings_that_are_wrong_are_said_with_their_place(tmp_path, text, member, found):
    with pytest.raises(DefinitionError, match=found):
        prepare(tmp_path, text, member)
