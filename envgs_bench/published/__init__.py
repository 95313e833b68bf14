"""Published data sets: fetched from the address that their configuration names, and unpacked where it expects them."""
