"""Serve a game of NetHack; its key is the first line of standard input."""

from target_server.server import main

from nle_body.body import NetHackBody

main(NetHackBody)
