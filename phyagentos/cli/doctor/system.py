"""Checks of the operating system: scheduling and ports."""

import os
import socket

from phyagentos.cli.doctor.finding import Finding, Grade

_PRIORITY = 10


def check_scheduling() -> Finding:
    """Whether a supervisor may ask to be woken first."""
    policy, parameters = os.sched_getscheduler(0), os.sched_getparam(0)
    try:
        os.sched_setscheduler(0, os.SCHED_FIFO, os.sched_param(_PRIORITY))
    except PermissionError:
        fix = (
            "Wake-ups may come a scheduler tick late. Allow it: 'rtprio 10' for this user in /etc/security/limits.conf."
        )
        return Finding("scheduling", Grade.WEAK, "real-time priority is not granted", fix)
    os.sched_setscheduler(0, policy, parameters)
    return Finding("scheduling", Grade.FINE, "real-time priority is granted")


def check_ports() -> Finding:
    """Whether a server can listen on this machine, as policy servers do."""
    try:
        with socket.create_server(("127.0.0.1", 0)) as server, socket.create_connection(server.getsockname()[:2], 2.0):
            return Finding("ports", Grade.FINE, "a local server can be reached")
    except OSError as error:
        return Finding(
            "ports", Grade.WEAK, str(error), "Policy servers need the loopback interface: ip link set lo up."
        )
