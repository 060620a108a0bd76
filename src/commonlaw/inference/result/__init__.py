"""From a search to a law: covariance, bands, averages, history."""
