"""Lives in Crafter: the library of the benchmark."""
