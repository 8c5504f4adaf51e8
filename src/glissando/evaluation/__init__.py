"""Errors against truth, and whether confidence is true."""
