"""One model fitted: its problem, states, coefficients and constants, and whether that fit is valid."""
