"""Population: what holds of scenes drawn from a distribution, and where each method fails."""
