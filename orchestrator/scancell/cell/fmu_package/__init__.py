"""Contents of an FMU beside its binary and its description: documentation, licences, terminals, a reference."""
