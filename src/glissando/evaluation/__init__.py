"""Evaluation of estimates: errors against truth, and consistency of the stated covariance."""
