"""Files in and out: recordings, robot files, posteriors, session logs, foreign formats."""
