"""One model fitted: its problem, states, coefficients and parameters, and whether that fit is valid."""
