"""Certificates for 127.0.0.1 that sign themselves, by the program `openssl`."""

import subprocess


def make_certificate(folder, name="this"):
    """PEM files of one: with its private key, and alone."""
    key, alone, both = (folder / f"{name}{end}" for end in (".key", ".pem", ".both.pem"))
    command = ["openssl", "req", "-x509", "-newkey", "ec", "-pkeyopt", "ec_paramgen_curve:prime256v1"]
    command += [
        "-nodes",
        "-days",
        "2",
        "-subj",
        "/CN=127.0.0.1",
        "-addext",
        "subjectAltName=IP:127.0.0.1",
        "-keyout",
        str(key),
        "-out",
        str(alone),
    ]
    subprocess.run(command, check=True, capture_output=True)
    both.write_text(alone.read_text() + key.read_text())
    return both, alone
