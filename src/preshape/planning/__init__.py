"""From a request to a plan: one request, one session, one document."""
