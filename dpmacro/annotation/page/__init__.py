"""One HTML page that opens from disk: demonstrations as strips of stages, for people to correct."""
