"""Serve a life in Crafter; its key is the first line of standard input."""

from target_server.server import main

from crafter_body.body import CrafterBody

main(CrafterBody)
