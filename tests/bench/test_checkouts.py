"""A clone that a user has is a part of a Python environment once it is what the environment declares."""

import subprocess

import pytest

from phyagentos.bench.availability import find_checkout_lacks, link_checkout
from phyagentos.errors import DefinitionError
from phyagentos.protocol.capabilities.environments import CheckoutSpec


def test_a_clone_is_checked_and_imported_where_it_is(tmp_path):
    clone, python = tmp_path / "clone", tmp_path / "environment" / "bin" / "python"
    packages = tmp_path / "environment" / "lib" / "python3.11" / "site-packages"
    for folder in (clone / "code", packages, python.parent):
        folder.mkdir(parents=True)
    git = ["git", "-C", str(clone), "-c", "user.name=t", "-c", "user.email=t@t"]
    for command in (["init", "-q"], ["commit", "-q", "--allow-empty", "-m", "one"]):
        subprocess.run([*git, *command], check=True)
    head = subprocess.run([*git, "rev-parse", "HEAD"], capture_output=True, text=True, check=True).stdout.strip()
    spec = CheckoutSpec(url="https://e.org/x", revisions={".": "0" * 40}, files=("mesh.obj",), paths=("code",))

    [lack] = find_checkout_lacks(python, "x", spec)
    assert "paos bench setup x --from FOLDER" in lack.hint
    with pytest.raises(DefinitionError) as refused:
        link_checkout(python, "x", spec, clone)
    assert [each.found for each in refused.value.problems] == ["no such file", f"revision {head}"]

    (clone / "mesh.obj").touch()
    whole = CheckoutSpec(url=spec.url, revisions={".": head}, files=spec.files, paths=spec.paths)
    link_checkout(python, "x", whole, clone)
    assert str(clone / "code") in (packages / "paos_checkout.pth").read_text().splitlines()
    assert list(find_checkout_lacks(python, "x", whole)) == []
