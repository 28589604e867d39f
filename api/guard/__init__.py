"""Who may send what, before any route: keys, rates, hosts, origins, sizes and times."""
