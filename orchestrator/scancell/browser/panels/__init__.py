"""What a person reads and operates."""
