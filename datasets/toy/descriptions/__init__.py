"""One toy scene a file, and the room that several of them stand in."""
