"""The last that the parent of all forks imports: what stands in memory by now is garbage in none of them.

A fork that collects it nevertheless copies every page; that was a third of what a lie costs.
"""

import gc

gc.collect()
gc.freeze()
gc.set_threshold(50_000, 20, 50)
