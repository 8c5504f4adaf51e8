"""The sensors: readings with their residuals, and uncertain sensor parameters."""
