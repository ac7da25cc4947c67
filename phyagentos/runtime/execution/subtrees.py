"""A tree and those that stand in it, each read once: what every check of a whole tree goes through."""

from collections.abc import Iterator

from phyagentos.errors import DefinitionError, Problem
from phyagentos.protocol.capabilities.library import Library
from phyagentos.protocol.capabilities.trees import Tree, list_subtrees, load_tree


def iter_trees(name: str, library: Library) -> Iterator[tuple[str, Tree | None, tuple[Problem, ...]]]:
    """Each by its name as far as it can be read, with its structural problems: parents first, absent subtrees none."""
    waiting, seen = [name], set[str]()
    while waiting:
        if (name := waiting.pop()) in seen:
            continue
        seen.add(name)
        try:
            tree, problems = load_tree(library.get_tree(name))
        except DefinitionError as error:
            tree, problems = None, error.problems
        yield name, tree, problems
        if tree is not None:
            waiting += reversed([each for each in dict.fromkeys(list_subtrees(tree)) if library.has_tree(each)])
