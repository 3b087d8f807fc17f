"""Controllers of robots over the interfaces of their makers."""
