"""Pictures of what documents and evidence say: graphs, statecharts, trees, scenes and films; imports neither plane."""
