"""preshape."""
