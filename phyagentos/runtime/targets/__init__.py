"""Bodies: the port every target fulfils, and the processes that simulate them."""
