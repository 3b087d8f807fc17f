"""What an FMU holds beside its binary and its description: documentation, licences, terminals, a reference."""
