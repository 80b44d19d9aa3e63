"""Meta control in the browser: see a plan and steer it (``preshape view``)."""
