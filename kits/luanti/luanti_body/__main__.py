"""Serve a player of Luanti; its key is the first line of standard input."""

from target_server.server import main

from luanti_body.body import LuantiBody

main(LuantiBody)
