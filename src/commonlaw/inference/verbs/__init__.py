"""What is done with laws: compare, refine, adapt, take other terms."""
