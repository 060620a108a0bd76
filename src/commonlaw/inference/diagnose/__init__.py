"""What a fitted law leaves open."""
