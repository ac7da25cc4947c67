"""A plug-in of pytest for runs of mutants: hypothesis looks for a failing example, not for the smallest."""

from hypothesis import Phase, settings

settings.register_profile("unshrunk", phases=(Phase.explicit, Phase.generate))
settings.load_profile("unshrunk")
