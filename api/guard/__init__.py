"""Checks of requests before any route: keys, rates, hosts, origins, sizes and times."""
