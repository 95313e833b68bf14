"""Sets of Gaussians: what they are made of, where they start, how they grow, shrink and share a budget."""
