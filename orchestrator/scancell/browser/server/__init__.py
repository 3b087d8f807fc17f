"""The server, and the validation of input from browsers."""
