"""The search for the law of one order: supports, inputs, errors."""
