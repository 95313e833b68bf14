"""From records to numbers: one tidy table, means, intervals."""
