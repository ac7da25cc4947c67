"""The contract of a leaf: sealed tick, coded failures, wrapped exceptions, interruptions that are told."""

import numpy as np
import pytest
from py_trees.ports import NoDataAvailable

from phyagentos.errors import DefinitionError
from phyagentos.runtime.execution.leaf import Leaf, LeafError, PortInformation, Role, Status
from phyagentos.runtime.execution.leaf_registry import LeafRegistry, register_file


class Twice(Leaf):
    """Runs one tick, then succeeds."""

    ROLE = Role.WAIT
    INPUT_PORTS = {"gain": PortInformation(data_type=float, required=False, description="Unused.")}
    OUTPUT_PORTS = {"level": PortInformation(data_type=float, required=False, description="A number.")}

    halted = 0

    def on_start(self):
        return Status.RUNNING

    def on_running(self):
        self.write("level", 3)
        return self.succeed("done", ticks=2)

    def on_halted(self):
        self.halted += 1


class Returns(Leaf):
    """Answers what it is told."""

    ROLE = Role.WAIT
    answer = None

    def on_start(self):
        if isinstance(self.answer, BaseException):
            raise self.answer
        return self.answer


@pytest.fixture
def leaf():
    return Twice("twice", context=None, path="root/twice")


def test_the_first_tick_starts_and_later_ones_run(leaf):
    leaf.tick_once()
    assert leaf.status is Status.RUNNING
    leaf.tick_once()

    assert (leaf.status, leaf.message, leaf.numbers) == (Status.SUCCESS, "done", {"ticks": 2})


def test_a_whole_number_is_written_as_a_number(leaf):
    values = {}
    leaf.wire(values, {"level": "main/height"})
    leaf.tick_once()
    leaf.tick_once()

    assert values == {"main/height": 3.0}
    assert isinstance(values["main/height"], float)


def test_what_nobody_reads_is_not_kept(leaf):
    values = {}
    leaf.wire(values, {})
    leaf.write("level", 3.0)

    assert values == {}


def test_an_optional_port_without_data_reads_as_none(leaf):
    assert leaf.find("gain") is None
    with pytest.raises(NoDataAvailable, match=r"nothing was written to input 'gain' of root/twice"):
        leaf.read("gain")


def test_defaults_of_ports_are_there_before_anybody_writes():
    class Preset(Returns):
        INPUT_PORTS = {"gain": PortInformation(data_type=list, default_value=[1])}
        OUTPUT_PORTS = {"level": PortInformation(data_type=float, default_value=0.5)}

    leaf, values = Preset("preset", None), {}
    leaf.wire(values, {"gain": "main/gain", "level": "main/level"})
    leaf.read("gain").append(2)

    assert (leaf.read("gain"), values) == ([1], {"main/level": 0.5})


@pytest.mark.parametrize("value", ["3", None])
def test_a_value_of_another_type_is_neither_written_nor_read(leaf, value):
    leaf.wire({"main/gain": value}, {"gain": "main/gain", "level": "main/level"})

    with pytest.raises(TypeError, match=r"port 'level' carries <class 'float'>, not"):
        leaf.write("level", value)
    with pytest.raises(TypeError, match=r"port 'gain' carries <class 'float'>, not"):
        leaf.find("gain")


def test_a_port_is_an_input_or_an_output():
    with pytest.raises(ValueError, match=r"port 'level' of Both is an input and an output"):

        class Both(Twice):
            INPUT_PORTS = Twice.OUTPUT_PORTS


def test_an_interruption_is_told_once_and_only_while_active(leaf):
    leaf.stop(Status.INVALID)
    assert leaf.halted == 0
    leaf.tick_once()
    leaf.stop(Status.INVALID)
    leaf.stop(Status.INVALID)

    assert leaf.halted == 1


@pytest.mark.parametrize("answer", [None, True, "SUCCESS", Status.INVALID, np.zeros(3), np.nan])
def test_an_answer_that_is_no_status_is_an_error_with_the_path(answer):
    leaf = Returns("returns", None, "root/returns")
    leaf.answer = answer

    with pytest.raises(
        LeafError, match=r"root/returns: TypeError: on_start answered .*; expected SUCCESS.*test_leaf\.py:"
    ):
        leaf.tick_once()


@pytest.mark.parametrize("error", [KeyError("gap"), StopIteration(), SystemExit(0), GeneratorExit(), RecursionError()])
def test_whatever_a_leaf_raises_is_its_error_with_the_place(error):
    leaf = Returns("returns", None, "root/returns")
    leaf.answer = error

    with pytest.raises(LeafError, match=rf"root/returns: {type(error).__name__}: .*test_leaf\.py:\d+\)"):
        leaf.tick_once()


def test_numbers_of_a_leaf_are_plain_data_or_an_error_with_the_place():
    class Measures(Returns):
        def on_start(self):
            return self.succeed("seen", **self.answer)

    leaf = Measures("measures", None, "root/measures")
    leaf.answer = {"height_m": np.float64(0.5), "axis": np.eye(2), "hits": (np.int64(3), True)}
    leaf.tick_once()
    assert leaf.numbers == {"height_m": 0.5, "axis": [[1.0, 0.0], [0.0, 1.0]], "hits": (3, True)}

    leaf.answer = {"height_m": object()}
    with pytest.raises(LeafError, match=r"TypeError: <object .* is no plain data \(.*test_leaf\.py:\d+\)"):
        leaf.tick_once()


def test_a_name_is_given_once():
    registry = LeafRegistry()
    registry.register("twice", Twice)
    registry.register("twice", Twice)

    with pytest.raises(DefinitionError, match=r"DUPLICATE_NAME: found 'twice', already .*Twice"):
        registry.register("twice", Returns)


def test_only_leaves_can_be_registered():
    with pytest.raises(DefinitionError, match=r"BROKEN_PYTHON: .*expected a subclass of phyagentos.skills.Leaf"):
        LeafRegistry().register("text", str)


def test_an_unknown_leaf_is_refused_with_the_nearest_name():
    registry = LeafRegistry()
    registry.register("twice", Twice)

    with pytest.raises(
        DefinitionError, match=r"UNKNOWN_NAME \(leaf\): found 'twic'; expected twice. Did you mean 'twice'\?"
    ):
        registry.get("twic")


def test_a_skills_own_leaves_are_loaded_from_its_folder(tmp_path):
    path = tmp_path / "behaviours.py"
    path.write_text(
        "from phyagentos.runtime.execution.leaf import Leaf, Role, Status\n"
        "class Nod(Leaf):\n"
        "    ROLE = Role.WAIT\n"
        "    INPUT_PORTS = {}\n"
        "    OUTPUT_PORTS = {}\n"
        "    def on_start(self):\n"
        "        return Status.SUCCESS\n"
        "def register(registry):\n"
        "    registry.register('nod', Nod)\n"
    )
    registry = LeafRegistry()

    register_file(registry, path)

    assert registry.names() == ["nod"]


@pytest.mark.parametrize(
    ("text", "reason"),
    [
        ("x = 1", "no such function"),
        ("import nothing_at_all", "loading it raised ModuleNotFound"),
        ("def register(registry", "loading it raised SyntaxError"),
        ("import sys; sys.exit(0)", "loading it raised SystemExit"),
        ("raise GeneratorExit", "loading it raised GeneratorExit"),
        ("def f(): f()\nf()", "loading it raised RecursionError"),
        ("def register(registry): 1 / 0", "register raised ZeroDivisionError"),
        ("def register(): pass", "register raised TypeError"),
        ("def register(registry): raise SystemExit", "register raised SystemExit"),
    ],
)
def test_a_broken_behaviours_file_is_named_with_the_reason(tmp_path, text, reason):
    path = tmp_path / "behaviours.py"
    path.write_text(text)

    with pytest.raises(DefinitionError, match=rf"behaviours.py(:1)?: BROKEN_PYTHON: found {reason}"):
        register_file(LeafRegistry(), path)


class Digs(Leaf):
    """Fails in a function of its own file, called by a library."""

    ROLE = Role.WAIT

    def on_start(self):
        return min([{}], key=lambda found: found["missing"])


@pytest.mark.parametrize("error", [ValueError("no"), SystemExit(3)])
def test_a_leaf_that_raises_names_the_line_in_its_own_file(error):
    leaf = Returns("returns", context=None)
    leaf.answer, line = error, Returns.on_start.__code__.co_firstlineno + 2
    with pytest.raises(LeafError, match=rf"{type(error).__name__}: .*test_leaf\.py:{line}\)$"):
        leaf.tick_once()
    line = Digs.on_start.__code__.co_firstlineno + 1
    with pytest.raises(LeafError, match=rf"KeyError: 'missing' \(.*test_leaf\.py:{line}\)$"):
        Digs("digs", context=None).tick_once()
