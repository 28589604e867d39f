"""Rules after the network: arrays in, arrays out."""
