"""Deliberate errors of the guard, and searches for the worst moment that find them."""
