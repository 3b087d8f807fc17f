"""Run folders, manifests, image files, tables and pictures on disk."""
