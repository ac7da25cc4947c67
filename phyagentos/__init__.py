"""phyagentos: robots run on sessions that are verified, not merely finished.

The package has two planes that meet only in documents: `phyagentos.agent` decides what should be done and judges what
was done; `phyagentos.runtime` decides how it is carried out. Their shared vocabulary is `phyagentos.protocol`.
"""

__version__ = "0.1.0"
