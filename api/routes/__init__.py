"""Routes: read the request, call one door, answer."""
