"""Serve an agent in ScienceWorld; its key is the first line of standard input."""

from target_server.server import main

from scienceworld_body.body import ScienceBody

main(ScienceBody)
