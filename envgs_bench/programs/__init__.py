"""Programs: what other trainers are told, how they are run, and the Gaussians that they write."""
