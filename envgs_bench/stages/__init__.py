"""What a run does: it trains, draws and scores the test views, and times them."""
