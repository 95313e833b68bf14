"""What is done with runs that have ended: opened again, scored again, asked for masks."""
