"""Ablation ladders: the methods of one scene, each with a part more than the one before, and which the scene needs."""
