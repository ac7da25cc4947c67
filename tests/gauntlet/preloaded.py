"""The last that the parent of all forks imports: what stands in memory by now is garbage in none of them.

A fork that collects it nevertheless copies every page; that was a third of what a lie costs.
"""

import gc

from numba.core.registry import cpu_target

cpu_target.typing_context.refresh()  # what a first kernel would wait for
cpu_target.target_context.refresh()
gc.collect()
gc.freeze()
gc.set_threshold(50_000, 20, 50)
