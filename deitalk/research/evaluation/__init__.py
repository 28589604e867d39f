"""Measurements that one table or picture of the documents needs."""
