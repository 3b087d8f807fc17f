"""Tool, table, trigger and arm, from scans of an artefact."""
