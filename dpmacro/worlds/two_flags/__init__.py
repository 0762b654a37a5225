"""TwoFlags-v0: the world, its teacher and the names of its failures."""
