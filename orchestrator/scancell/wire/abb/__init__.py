"""Controllers of ABB."""
