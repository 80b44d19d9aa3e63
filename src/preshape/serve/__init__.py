"""``preshape serve``: plans over HTTP, from warm planner processes (docs/serve.md)."""
