"""From sensing to belief: the port, the pipelines and their parts."""
