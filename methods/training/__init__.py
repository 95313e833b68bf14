"""Training: the clock of a run, what a step minimizes and how it is taken, on a GPU from CUDA graphs."""
