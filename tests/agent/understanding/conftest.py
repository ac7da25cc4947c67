"""Vocabularies of shipped scenes, read once, and an embedded understander."""

from functools import cache

import pytest

from phyagentos.agent.goals.catalogue import Catalogue
from phyagentos.agent.understanding.embedded import EmbeddedUnderstander
from phyagentos.agent.understanding.vocabulary import Vocabulary
from phyagentos.assembly.project import open_library

CUBES = "tabletop/cubes_and_trays"


@pytest.fixture(autouse=True)
def known_scene() -> None:
    """The shipped scenes, in the place of the synthetic one of the other tests of the agent."""


@cache
def read_catalogue() -> Catalogue:
    return Catalogue.read(open_library())


@cache
def get_vocabulary(scene: str = CUBES) -> Vocabulary:
    return Vocabulary.read(read_catalogue(), scene)


@pytest.fixture
def understand():
    def call(request: str, scene: str | Vocabulary = CUBES, **answers: str):
        vocabulary = get_vocabulary(scene) if isinstance(scene, str) else scene
        return EmbeddedUnderstander().understand(request, vocabulary, answers)

    return call
