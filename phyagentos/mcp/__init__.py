"""The tools and resources of a workspace over the Model Context Protocol."""
