"""Goal graphs: authoring format, checked DAG, expansion, skill selection, session contracts."""
