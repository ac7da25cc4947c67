"""Serves a body to phyagentos over WebSocket, from an environment that needs `websockets` and `msgpack` alone."""
