"""The server, and what it takes from browsers."""
