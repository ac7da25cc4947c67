"""Deserialise messages by rclpy's own C code, and print what they say. Runs in the environment of `--ros2-python`."""

import hashlib
import importlib
import json
import sys

from rclpy.serialization import deserialize_message


def tell(message):
    """The fields of a message, arrays of bytes as their hash."""
    if hasattr(message, "get_fields_and_field_types"):
        return {name: tell(getattr(message, name)) for name in message.get_fields_and_field_types()}
    if getattr(message, "typecode", "") == "B":
        return hashlib.sha256(message.tobytes()).hexdigest()
    if isinstance(message, (str, int, float)):
        return repr(message) if message != message else message
    return [tell(each) for each in message]


for line in sys.stdin:
    kind, data = line.split()
    package, _, name = kind.split("/")
    message = deserialize_message(bytes.fromhex(data), getattr(importlib.import_module(f"{package}.msg"), name))
    sys.stdout.write(f"{json.dumps(tell(message))}\n")
