"""Selection: which of the equations that a solver found is the law, and why."""
