"""One loader for every kind of plug-in: sorted names, lazily imported, one owner a name, and what broke is said."""

import sys

import pytest

from phyagentos.errors import DefinitionError
from phyagentos.plugins import Plugins, import_object
from tests.packages import install

GROUP = "phyagentos.judges"


@pytest.fixture
def announce(tmp_path, monkeypatch):
    """Lays installed packages where Python looks for them: name, Python and entry points of each."""

    def announce(package, code, **points):
        install(tmp_path / package, package, code, {GROUP: points})
        monkeypatch.syspath_prepend(tmp_path / package)
        monkeypatch.delitem(sys.modules, package, raising=False)

    return announce


def test_names_are_sorted_and_nothing_is_imported_for_them(announce):
    announce("zeal", "raise AssertionError('imported')", zeal="zeal:ZEAL")
    plugins = Plugins(GROUP, {"own": 1, "later": "no_such_module:THING"})

    assert plugins.names() == ["later", "own", "zeal"]
    assert "zeal" not in sys.modules


def test_a_plug_in_is_imported_when_it_is_loaded(announce):
    announce("zeal", "ZEAL = 7", zeal="zeal:ZEAL")
    plugins = Plugins(GROUP, {"own": 1, "join": "posixpath:join"}, kind=object)

    assert plugins.load("zeal") == 7
    assert plugins.load("join") is __import__("posixpath").join
    assert list(plugins.load_all()) == ["join", "own", "zeal"]


def test_an_unknown_name_gets_the_nearest_one_and_the_noun_of_its_group():
    with pytest.raises(
        DefinitionError, match=r"here: UNKNOWN_NAME \(judge\): found 'zeel'; expected zeal\. Did you mean"
    ):
        Plugins(GROUP, {"zeal": 1}, noun="judge").load("zeel", "here")


def test_a_name_of_two_packages_is_refused_with_both(announce):
    announce("one", "ZEAL = 1", zeal="one:ZEAL")
    announce("two", "ZEAL = 2", zeal="two:ZEAL")

    with pytest.raises(DefinitionError, match="DUPLICATE_NAME: found 'zeal' of package one and of package two"):
        Plugins(GROUP).names()


def test_a_package_never_replaces_what_ships(announce):
    announce("one", "ZEAL = 1", zeal="one:ZEAL")

    with pytest.raises(DefinitionError, match="'zeal' of package phyagentos and of package one"):
        Plugins(GROUP, {"zeal": 0}).load("zeal")


@pytest.mark.parametrize(
    ("code", "found"),
    [
        ("1 / 0", r"'zeal' \(one:ZEAL\) of package one raised ZeroDivisionError: division by zero"),
        ("import sys; sys.exit(0)", "raised SystemExit: 0"),
        ("", "raised AttributeError: module 'one' has no attribute 'ZEAL'"),
        ("ZEAL = 'text'", "a str; expected a int"),
    ],
)
def test_what_a_package_broke_is_said_to_those_alone_that_name_it(announce, code, found):
    announce("one", code, zeal="one:ZEAL")
    plugins = Plugins[int](GROUP, {"own": 1}, kind=int)

    assert plugins.load("own") == 1
    with pytest.raises(DefinitionError, match=f"{GROUP}: BROKEN_PYTHON: found .*{found}"):
        plugins.load("zeal")


def test_a_plug_in_that_has_a_name_is_announced_under_it(announce):
    announce("one", "class ZEAL: name = 'haste'", zeal="one:ZEAL")

    with pytest.raises(DefinitionError, match="is called 'haste'; expected the name 'zeal'"):
        Plugins(GROUP).load("zeal")


def test_an_object_named_by_module_is_imported_or_refused_with_the_callers_noun():
    assert import_object("posixpath:join", "scorer", "scorer") is __import__("posixpath").join
    with pytest.raises(DefinitionError, match=r"scorer: UNKNOWN_NAME \(scorer\): found 'posixpath:none'"):
        import_object("posixpath:none", "scorer", "scorer")
