"""From photographs as cameras left them to views as methods want them."""
