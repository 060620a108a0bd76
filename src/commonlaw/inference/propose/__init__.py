"""Other models to compare: richer terms, ratios, forcing, latent states, orders."""
