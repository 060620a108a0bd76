"""What laws are compared by: the parts of the score."""
