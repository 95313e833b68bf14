"""What data say of themselves, held against each other: refused where it cannot be, noted where it is odd."""
