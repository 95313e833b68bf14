"""From records to numbers: what tells runs apart, one tidy table, means and intervals; and what the paper printed."""
