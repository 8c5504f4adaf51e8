"""Figures, films and HTML pages of estimates and plans."""
