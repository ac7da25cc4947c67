"""Serve CALVIN's arm; its key is the first line of standard input, its settings as JSON the second."""

from target_server.server import main

from calvin_body.body import make_body

main(make_body)
