"""What a run is: its identity, its process, its record while under way, and what became of it."""
